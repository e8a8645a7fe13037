"""`adaptsim new` writes files that run; `adaptsim completion` knows every command and option."""

import json
import os
import subprocess
import sys
import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import mujoco
import pytest

from adaptsim_jax.cli import main
from adaptsim_jax.commands import SUMMARIES
from adaptsim_jax.commands.parser import TASKS, command_parser
from adaptsim_jax.logs.read import read_with_model

ROOT = Path(__file__).parents[2]
STARTS = [
    ("effect", "0.1"),
    pytest.param("engine", "apart by", marks=pytest.mark.slow),
    pytest.param("baseline", "cable_drag earns", marks=pytest.mark.slow),
    pytest.param("task", "reward where it is slick", marks=pytest.mark.slow),
]


@pytest.mark.parametrize("kind, tells", STARTS)
def test_a_file_of_python_runs(kind, tells, tmp_path, capsys):
    assert main(["new", kind, "cable_drag", "--dir", str(tmp_path)]) == 0
    assert f"next: python {tmp_path / 'cable_drag.py'}" in capsys.readouterr().out
    done = subprocess.run(
        [sys.executable, "-W", "error", "cable_drag.py"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert tells in done.stdout


@pytest.mark.slow
def test_what_was_begun_is_installed_and_compared(tmp_path):
    """A task, a baseline and an engine by their entry points: `adaptsim compare` runs the one with
    rows of ours and of the other.
    """
    for kind, name in (("task", "puck"), ("baseline", "walk"), ("engine", "weak")):
        assert main(["new", kind, name, "--dir", str(tmp_path)]) == 0
    info = tmp_path / "mine-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n")
    points = {
        "tasks": "puck = puck:TASK",
        "baselines": "exact.walk = walk:walk",
        "backends": "pendulum.weak = weak:ENGINE",
    }
    (info / "entry_points.txt").write_text(
        "".join(f"[adaptsim.{g}]\n{line}\n" for g, line in points.items())
    )
    environment = os.environ | {"PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}

    def run(*words):
        command = [sys.executable, *words]
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
        return done.stdout

    small = ["--seeds", "2", "--set", "iterations=2", "--set", "sysid.simulations=50"]
    small += [
        "--set",
        "train.phase1.trajectories=40",
        "--set",
        "train.phase1.parallel=10",
        "--set",
        "train.phase1.updates=4",
    ]
    methods = "adaptsim,sysid-point,bayesopt,udr,udr-target,learn-in-target,oracle"
    run("-m", "adaptsim_jax", "compare", "puck", "--out", "puck", "--methods", methods, *small)
    rows = json.loads((tmp_path / "puck" / "results.json").read_text())["rows"]
    mean = {(row["method"], row["setting"]): row["mean"] for row in rows}
    assert len(mean) == 14 and mean["oracle", "slick"] > 0.99
    assert (
        mean["udr", "slick"] < 0.5 < mean["udr", "middle"]
    )  # a push for all of Omega goes too far where it is slick
    run(
        "-m",
        "adaptsim_jax",
        "compare",
        "pendulum",
        "--out",
        "walk",
        "--methods",
        "walk",
        "--settings",
        "wd",
        "--seeds",
        "1",
    )
    code = (
        "from adaptsim_jax import make_backend; print(make_backend('pendulum', 'weak', 0.01).name)"
    )
    assert run("-c", code).strip() == "weak"
    protocols = str(ROOT / "tests" / "test_protocols.py")
    assert "failed" not in run(
        "-m", "pytest", "-q", protocols, "-k", "puck or weak or test_baselines"
    )


@pytest.mark.parametrize(
    "kind, group, name, names",
    [("effect", "effects", "worm", ["worm"]), ("task", "tasks", "walk", ["walk"])],
)
def test_the_first_file_comes_with_a_pyproject(
    kind, group, name, names, tmp_path, monkeypatch, capsys
):
    """Its entry points load what they name; a second file leaves it alone, and tells the lines to
    add.
    """
    assert main(["new", kind, name, "--dir", str(tmp_path)]) == 0
    text = (tmp_path / "pyproject.toml").read_text()
    table = tomllib.loads(text)
    assert table["tool"]["setuptools"]["py-modules"] == [name]
    points = table["project"]["entry-points"][f"adaptsim.{group}"]
    assert list(points) == names
    monkeypatch.syspath_prepend(tmp_path)
    for point, value in points.items():
        thing = EntryPoint(point, value, f"adaptsim.{group}").load()
        assert thing is not None
        if kind == "effect":
            hash(thing)  # a static argument of compiled functions, whatever its grid is
    capsys.readouterr()
    assert main(["new", "baseline", "hill", "--dir", str(tmp_path)]) == 0
    assert (tmp_path / "pyproject.toml").read_text() == text
    assert (
        '[project.entry-points."adaptsim.baselines"]\n"exact.hill" = "hill:hill"'
        in capsys.readouterr().out
    )


def test_a_name_that_begins_with_my_is_not_doubled(tmp_path):
    assert main(["new", "effect", "my_effect", "--dir", str(tmp_path)]) == 0
    assert (
        tomllib.loads((tmp_path / "pyproject.toml").read_text())["project"]["name"] == "my-effect"
    )


def test_a_mechanism_is_one_that_logs_can_be_read_with(tmp_path):
    assert main(["new", "mechanism", "arm", "--dir", str(tmp_path)]) == 0
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    assert (model.nq, model.nu) == (2, 2)
    rows = "".join(
        f"{0.01 * k:.2f},{0.1 + 0.01 * k:.2f},{0.2 - 0.01 * k:.2f},0,0\n" for k in range(30)
    )
    (tmp_path / "log.csv").write_text("time,q_shoulder,q_elbow,tau_shoulder,tau_elbow\n" + rows)
    _, log = read_with_model(tmp_path / "log.csv", tmp_path / "arm.xml")
    assert log.joint_names == ("shoulder", "elbow")


@pytest.mark.parametrize(
    "kind, name",
    [("effect", "coulomb"), ("task", "pushing"), ("engine", "native"), ("baseline", "gradient")],
)
def test_a_name_that_is_one_of_ours_is_refused(kind, name, tmp_path, capsys):
    assert main(["new", kind, name, "--dir", str(tmp_path)]) == 2
    assert f"{kind} '{name}' is there already" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_nothing_is_overwritten_and_names_are_checked(tmp_path, capsys):
    (tmp_path / "arm.xml").write_text("mine")
    assert main(["new", "mechanism", "arm", "--dir", str(tmp_path)]) == 2
    assert (tmp_path / "arm.xml").read_text() == "mine"
    assert main(["new", "effect", "My-Effect", "--dir", str(tmp_path)]) == 2
    assert main(["new", "effect", "lambda", "--dir", str(tmp_path)]) == 2
    assert "letters in lower case" in capsys.readouterr().err


def options_of(name):
    """Options of a command, and the words that its first argument may be."""
    for action in command_parser(name)._actions:
        yield from (option for option in action.option_strings if option.startswith("--"))
        if not action.option_strings:
            yield from TASKS if action.metavar == "TASK" else map(str, action.choices or ())


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_holds_all(shell, capsys):
    assert main(["completion", shell]) == 0
    text = capsys.readouterr().out
    for name in SUMMARIES:
        for option in options_of(name):
            assert name in text and option.removeprefix("--" if shell == "fish" else "") in text


def test_bash_completes(capsys):
    assert main(["completion", "bash"]) == 0
    script = capsys.readouterr().out
    ask = 'COMP_WORDS=(adaptsim {}); COMP_CWORD={}; _shtab_adaptsim; echo "${{COMPREPLY[@]}}"\n'
    script += ask.format("dia", 1) + ask.format("train pend", 2) + ask.format("diagnose --with", 2)
    found = subprocess.run(
        ["bash", "-c", script], capture_output=True, text=True, check=True
    ).stdout
    assert found.split("\n")[:3] == ["diagnose", "pendulum", "--without"]
