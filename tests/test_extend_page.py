"""The package that docs/howto/extend.md shows is found once installed, does what the page says, and
keeps the protocols.
"""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE, EXAMPLE = ROOT / "docs" / "howto" / "extend.md", ROOT / "examples" / "my_robot"


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """A folder with the package's files, and the metadata that installing them would write; the
    environment that finds it.
    """
    folder = tmp_path_factory.mktemp("third_party")
    shutil.copytree(EXAMPLE, folder, dirs_exist_ok=True)
    groups = tomllib.loads((folder / "pyproject.toml").read_text())["project"]["entry-points"]
    lines = [
        f"[{group}]\n" + "".join(f"{k} = {v}\n" for k, v in points.items())
        for group, points in groups.items()
    ]
    info = folder / "my_robot-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my_robot\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("\n".join(lines))
    return folder, os.environ | {"PYTHONPATH": f"{folder}{os.pathsep}{ROOT}"}


def test_the_page_shows_every_file_of_the_package():
    shown = set(re.findall(r'^--8<-- "(\S+)"$', PAGE.read_text(), re.M))
    assert shown == {
        str(path.relative_to(ROOT))
        for path in EXAMPLE.rglob("*.*")
        if path.suffix in (".py", ".toml") and "build" not in path.parts
    }


def output(installed, *arguments):
    folder, environment = installed
    done = subprocess.run(
        [sys.executable, *arguments], cwd=folder, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    return done.stdout


def test_a_command_lists_what_is_installed(installed):
    shown = output(installed, "-m", "adaptsim_jax", "effects", "--name", "magnet")
    assert "-pull q exp(-(q / reach)^2)" in shown and "N m/rad" in shown


@pytest.mark.parametrize(("name", "task"), [("coulomb", "pendulum"), ("armature", "mechanism")])
def test_two_things_of_one_name_are_refused(installed, name, task):
    folder, environment = installed
    twin = folder / "twin-1.0.dist-info"
    twin.mkdir()
    (twin / "METADATA").write_text("Metadata-Version: 2.1\nName: twin\nVersion: 1.0\n")
    (twin / "entry_points.txt").write_text(f"[adaptsim.effects]\n{name} = twin:X\n")
    command = [sys.executable, "-m", "adaptsim_jax", "effects", task, "--brief"]
    try:
        done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    finally:
        for file in twin.iterdir():
            file.unlink()
        twin.rmdir()
    assert done.returncode == 2 and f"{name} = twin:X" in done.stderr and "rename it" in done.stderr


@pytest.mark.slow
def test_the_page_runs(installed):
    lines = output(installed, "use.py").splitlines()
    mine = [
        line for line in lines if not line.startswith("Failed to import")
    ]  # MJX says so of what is not installed
    first, second, third, fourth, fifth = mine
    assert first == "magnet" and second.startswith("rewards of puck 0.")
    assert float(third.split()[-1]) < 1e-5  # the same motion, a row later, in single precision
    assert re.fullmatch(r"random search earns -?\d+\.\d+ of 1", fourth)
    assert re.search(r"earns 0\.\d+, and the best (0\.99|1\.00)$", fifth)


@pytest.mark.slow
def test_what_is_installed_keeps_the_protocols(installed):
    names = "puck or magnet or late or test_baselines"
    shown = output(
        installed,
        "-m",
        "pytest",
        "-q",
        "-rs",
        str(ROOT / "tests" / "test_protocols.py"),
        "-k",
        names,
    )
    passed = re.search(r"(\d+) passed", shown)
    assert passed and int(passed[1]) >= 8 and "failed" not in shown
