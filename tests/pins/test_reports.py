"""What reports say, and the arrays behind their pages: one small diagnosis of each kind of task."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adaptsim_jax.attribution.diagnose import diagnose as diagnose_mechanism
from adaptsim_jax.attribution.pendulum_diagnosis import diagnose_pendulum
from adaptsim_jax.diagnosis.simulated import diagnose_simulator
from adaptsim_jax.effects.joints.catalogue import MACHINE
from adaptsim_jax.logs.read import read_source_and_log
from adaptsim_jax.simulators.mujoco.diagnosed import diagnose as diagnose_mujoco
from adaptsim_jax.simulators.mujoco.diagnosed import simulator
from adaptsim_jax.tasks.scooping.diagnosis.diagnose import diagnose as diagnose_scoops
from adaptsim_jax.tasks.toss.catalogue import EFFECTS as TOSSES
from adaptsim_jax.tasks.toss.diagnose import diagnose as diagnose_tosses
from tests.attribution.small_rig import make_trials
from tests.attribution.small_rig import written as rig_written
from tests.attribution.test_pendulum_diagnosis import REST, rubbing
from tests.diagnosis.test_simulator import recorded
from tests.pins.machines import record
from tests.pins.stored import check, mark
from tests.tasks.scooping.test_diagnosis import measured, simple, simulated
from tests.tasks.scooping.test_diagnosis import written as scoops_written
from tests.tasks.toss.test_toss import folder as tossed

__all__ = ["simple"]  # a fixture

LOOSE = 1e-4
FIELDS = {"coulomb", "gain", "delay"}
JOINTS = {"coulomb", "viscous", "torque_gain", "armature", "position_gain"}


ROWS = ("effects", "candidates")


def without(known, names: set[str]) -> tuple[str, ...]:
    """Names of the effects but those."""
    return tuple(e.name for e in known if e.name not in names)


def sorted_rows(z: Any) -> Any:
    """With keys in order, and arrays in four numbers."""
    if isinstance(z, dict):
        return {str(k): sorted_rows(z[k]) for k in sorted(z, key=str)}
    if isinstance(z, np.ndarray):
        return mark(z)
    if isinstance(z, (list, tuple)):
        return [sorted_rows(v) for v in z]
    return z


def pin(name: str, folder: Path, diagnosed: Callable[..., dict[str, Any]]) -> None:
    """Compare the report of `diagnosed(out=, page=)`, and what its page gets, with what is stored."""  # noqa: E501
    evidence: dict[str, Any] = {}

    def page(at: Path, report: dict[str, Any], arrays: dict[str, Any]) -> None:
        evidence.update(arrays)

    report = dict(diagnosed(out=folder / "out", page=page))
    files = sorted(p.name for p in (folder / "out").iterdir())
    del report["run"], evidence["run"]
    report.pop("numbers", None)  # has tests of its own
    made = {"report": report, "evidence": evidence, "files": files}
    check(f"report_{name}", sorted_rows(made), LOOSE)


def test_tanks(tmp_path):
    tanks = recorded({"leak": 0.004}, seed=3)
    pin("tanks", tmp_path, lambda **more: diagnose_simulator(tanks, **more))


@pytest.mark.long
@pytest.mark.parametrize(
    ("machine", "objective", "more"),
    [
        ("motors", "stretches", set()),
        ("motors", "torque", set()),
        ("motors", "stretches", {"coulomb"}),
        ("motors", "torque", {"coulomb", "armature"}),
    ],
)
def test_machines(machine, objective, more, tmp_path):
    data = record(tmp_path / "log", machine)
    left = without(MACHINE, JOINTS - more)
    name = "_".join([machine, objective, *sorted(more)])

    def diagnosed(**where):
        return diagnose_mechanism(data, exclude=left, yardstick=objective, **where)

    pin(name, tmp_path, diagnosed)


@pytest.mark.long
def test_mujoco(tmp_path):
    made = simulator(*read_source_and_log(record(tmp_path / "log", "servos")))
    left = tuple({c.name for c in made.candidates if c.name.split(" at ")[0] not in FIELDS})
    pin("mujoco", tmp_path, lambda **more: diagnose_mujoco(made, exclude=left, **more))


@pytest.mark.long
def test_pendulums(tmp_path):
    trials = make_trials(3, 3, 1.5, 100.0, noise=0.2, extra=rubbing, velocity=False)
    (tmp_path / "log").mkdir()
    data = rig_written(tmp_path / "log", trials)
    pin("pendulum", tmp_path, lambda **more: diagnose_pendulum(data, exclude=REST, **more))


@pytest.mark.long
def test_scoops(tmp_path, simple):
    data = scoops_written(tmp_path / "log", measured(simulated(distance_offset=0.006)))
    pin("scoops", tmp_path, lambda **more: diagnose_scoops(data, **more))


@pytest.mark.long
def test_tosses(tmp_path):
    """A toss that strikes twice is chaotic: processors give other numbers, and the same names."""
    data, left = tossed(tmp_path, count=5), without(TOSSES, {"clock_scale", "tilt"})
    report = diagnose_tosses(data, exclude=left, out=tmp_path / "out")
    names = {key: [(row["name"], row["where"]) for row in report[key]] for key in ROWS}
    files = sorted(p.name for p in (tmp_path / "out").iterdir())
    made = {"report": sorted(report), "verdict": report["verdict"], **names, "files": files}
    check("names_toss", made)
