"""What the package asks for: bounds that its neighbours can share, and lock files within them."""

import tomllib
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
CORE = [Requirement(line) for line in PROJECT["dependencies"]]
BY_DATE = {"flatbuffers"}  # its versions are dates, which promise nothing
MJLAB = "3.11.0"  # the MuJoCo of mjlab 1.6 (`~=3.11.0`); Playground 0.2 takes 3.6 or newer


def locked():
    lines = (ROOT / "requirements.lock").read_text(encoding="utf-8").splitlines()
    return {
        canonicalize_name(name): version
        for name, _, version in (line.partition("==") for line in lines if "==" in line)
    }


def test_every_requirement_of_the_core_has_both_bounds():
    for requirement in CORE:
        operators = {part.operator for part in requirement.specifier}
        assert operators == ({">="} if requirement.name in BY_DATE else {">=", "<"}), requirement


def test_the_lock_is_within_the_bounds():
    versions = locked()
    for requirement in CORE:
        version = versions[canonicalize_name(requirement.name)]
        assert requirement.specifier.contains(version), (str(requirement), version)


def test_mujoco_is_shared_with_mjlab_and_is_that_of_mjx():
    mujoco, mjx = (next(r for r in CORE if r.name == n) for n in ("mujoco", "mujoco-mjx"))
    assert mujoco.specifier == mjx.specifier and mujoco.specifier.contains(MJLAB)
