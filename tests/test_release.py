"""What is released: one version everywhere, and archives that hold every file of the package.

`make check-dist` installs both into empty environments and runs the demo.
"""

import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

import adaptsim_jax

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
BUILD = "from setuptools import build_meta as b; import sys; b.build_{}(sys.argv[1])"


def files():
    """Files of the package that git knows, as they stand in an archive."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "adaptsim_jax"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if listed.returncode:
        pytest.skip("no checkout of git")
    return set(listed.stdout.split())


def test_one_version_everywhere():
    version = PROJECT["project"]["version"]
    assert adaptsim_jax.__version__ == version
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    first = re.search(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.M)
    assert first and first[1] == version


def test_every_kind_of_file_is_declared():
    """Before anything is built: a suffix that package-data lacks is missed in the wheel alone."""
    declared = PROJECT["tool"]["setuptools"]["package-data"]["adaptsim_jax"]
    suffixes = {Path(name).suffix for name in files() if Path(name).name != "py.typed"}
    assert suffixes <= {Path(pattern).suffix for pattern in declared} | {".py"}


@pytest.mark.long
def test_both_archives_hold_every_file(tmp_path):
    for file in files() | {"pyproject.toml", "README.md", "LICENSE"}:
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).write_bytes((ROOT / file).read_bytes())
    for kind in ("wheel", "sdist"):
        command = [sys.executable, "-c", BUILD.format(kind), "dist"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    (wheel,) = (tmp_path / "dist").glob("*.whl")
    (source,) = (tmp_path / "dist").glob("*.tar.gz")
    with zipfile.ZipFile(wheel) as archive:
        assert files() <= set(archive.namelist())
    with tarfile.open(source) as archive:
        assert files() <= {name.partition("/")[2] for name in archive.getnames()}
