"""The yardstick: any model over recordings, simulated (`forecast.py`) and in the torque along the
measured motion, beside what needs no
model (`measures.py`). The error is the root mean square over a stretch, joint by joint.
"""

import dataclasses
import pickle
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from operator import attrgetter
from pathlib import Path as File
from typing import Any

import mujoco
import numpy as np

from adaptsim_jax.attribution.choice import Choice, choose
from adaptsim_jax.attribution.conventions import check_conventions
from adaptsim_jax.attribution.criteria import CHOICE
from adaptsim_jax.attribution.equation.balance import balances
from adaptsim_jax.attribution.equation.models import Span
from adaptsim_jax.attribution.equation.rubbing import giving
from adaptsim_jax.attribution.forecast import forecast, without_a_model
from adaptsim_jax.attribution.load import load
from adaptsim_jax.attribution.machine import Machine
from adaptsim_jax.attribution.measures import (
    NAMES,
    STRETCHES,
    TORQUE,
    WHOLE,
    Measure,
    of_simulation,
    of_torque,
    predicts_nothing,
)
from adaptsim_jax.attribution.parameters import Vector
from adaptsim_jax.attribution.problem import TreeProblem
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.diagnosis.criteria import REPORT
from adaptsim_jax.diagnosis.recommended import FileReplay, joint_errors
from adaptsim_jax.diagnosis.straight import doing_nothing, skill
from adaptsim_jax.effects.joints.catalogue import MACHINE
from adaptsim_jax.logs.pool import Data
from adaptsim_jax.logs.quality.contradictions import AS_DECLARED
from adaptsim_jax.simulators.mujoco.replay import replayed as mujoco_replayed

WRITTEN = ("model.xml", "model.toml")  # what a diagnosis writes for simulation


@dataclass(frozen=True)
class Replay:
    """error [W, n] rad or m by stretch and joint; trial [W]; measured and simulated angles [W, L+1,
    n]; time [W, L+1] s; notes: what the reader says of the recording, and what its motion
    contradicts of the declared columns; line, still [W, n]: what a straight line and holding still
    leave; measures: the yardsticks (`measures.py`).
    """

    joint_names: tuple[str, ...]
    kinds: tuple[str, ...]
    trial_names: tuple[str, ...]
    trial: np.ndarray
    error: np.ndarray
    time: np.ndarray
    measured: np.ndarray
    simulated: np.ndarray
    seen: np.ndarray
    horizon: float
    notes: tuple[str, ...] = ()
    line: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    still: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    measures: Mapping[str, Measure | None] = field(default_factory=dict)

    def as_dict(self) -> Table:
        """What `--json` prints."""
        hinge = [j for j, k in enumerate(self.kinds) if k == "hinge"]
        main = hinge or list(range(len(self.kinds)))
        pool = self.error[:, main]

        def unit(j):
            if self.kinds[j] == "hinge":
                return "rad"
            return "m"

        def some(e):
            return {
                "median": _median(e),
                "rms": _rms(e),
                "ran_away": float(np.mean(e > CHOICE.ran_away)),
            }

        def beside(j):
            line, still = self.line[:, j], self.still[:, j]
            return {
                "straight_line": _median(line),
                "hold_still": _median(still),
                "skill": skill(_median(self.error[:, j]), _median(line), _median(still)),
            }

        joints = {
            name: some(self.error[:, j]) | {"unit": unit(j)} | beside(j)
            for j, name in enumerate(self.joint_names)
        }
        measures = {name: m.as_dict() for name, m in self.measures.items() if m is not None}
        trials = {
            name: some(self.error[self.trial == k][:, main])
            for k, name in enumerate(self.trial_names)
            if np.any(self.trial == k)
        }
        return {
            **some(pool),
            "unit": unit(main[0]),
            **beside(main),
            "horizon": self.horizon,
            "stretches": len(self.error),
            "joints": joints,
            "yardsticks": measures,
            "predicts_nothing": predicts_nothing(self.measures),
            "trials": trials,
            "notes": list(self.notes),
        }


def _median(e: np.ndarray) -> float:
    if e.size:
        return float(np.median(e))
    return float("nan")


def _rms(e: np.ndarray) -> float:
    if e.size:
        return float(np.sqrt(np.mean(np.square(e))))
    return float("nan")


def replay(
    machine: Machine,
    horizon: float = 0.5,
    vector: Vector | None = None,
    asked: Sequence[str] = (STRETCHES,),
    most: int = 100_000,
    roughly: bool = False,
) -> Replay:
    """A machine over its own recording.

    Args:
        horizon: s, 0 for each trial in one go.
        vector: Fitted values, or the file's.
        asked: Which yardsticks, beside the simulated stretches.
        most: Stretches at most.
        roughly: Whether their starts are fitted without derivatives, in a third of the time.
    """
    spans = [t.span for t in machine.tracks]
    span = min(horizon or 0.98 * min(spans), max(spans))
    problem = machine.problem(MACHINE, span, most)
    problem = giving(problem, machine.tree) if machine.gives else problem
    vector = vector if vector is not None else Vector((), np.zeros(0))
    found = replayed(problem, vector, span, roughly)
    measures: dict[str, Measure | None] = dict(found.measures)
    if WHOLE in asked and horizon:
        measures[WHOLE] = _over_whole_trials(machine, vector)
    if TORQUE in asked:
        measures[TORQUE] = of_torque(problem, balances(problem, machine.tracks), vector)
    return dataclasses.replace(found, measures=measures, notes=_shorter(horizon, span, max(spans)))


ALIKE = 1.25  # times the shortest of some trials, which are judged over its length together


def _over_whole_trials(machine: Machine, vector: Vector) -> Measure:
    """Medians over trials, each over its own length, or that of others that are nearly as short."""
    alike: list[list[Any]] = []
    for track in sorted(machine.tracks, key=attrgetter("span")):
        if not alike or track.span > ALIKE * alike[-1][0].span:
            alike.append([])
        alike[-1].append(track)
    parts = [replay(dataclasses.replace(machine, tracks=tracks), 0.0, vector) for tracks in alike]
    spans = np.repeat([part.horizon for part in parts], [len(part.error) for part in parts])
    error, line, still = (
        np.median(np.concatenate([getattr(part, name) for part in parts]), 0)
        for name in ("error", "line", "still")
    )
    one: Any = parts[0].measures[STRETCHES]
    return Measure(WHOLE, float(np.median(spans)), error, line, still, one.joints, one.units)


def _shorter(horizon: float, span: float, longest: float) -> tuple[str, ...]:
    """A note where stretches of `span` s are not as long as was asked for."""
    if horizon > span:
        return (f"no trial is {horizon:g} s long: stretches are of {span:.4g} s",)
    if not horizon and longest > ALIKE * span:
        return (f"trials are up to {longest:.4g} s long: all are cut to the shortest's {span:.4g}",)
    return ()


def replayed(problem: TreeProblem, vector: Vector, horizon: float, roughly: bool) -> Replay:
    """Of a prepared problem at the values of `vector`."""
    found = forecast(problem, vector, roughly)
    s, count = problem.groups[0].stretches, len(problem.fold)
    line, still = without_a_model(problem)
    measure = of_simulation(problem, found.error, STRETCHES, horizon)
    return Replay(
        problem.joint_names,
        problem.kinds,
        s.names,
        s.trial[:count],
        found.error,
        s.time.T[:count],
        found.measured,
        found.simulated,
        found.seen,
        horizon,
        (),
        line,
        still,
        {STRETCHES: measure},
    )


def replay_files(
    model: str | File | None,
    data: Data,
    horizon: float = 0.5,
    asked: Sequence[str] | None = None,
    simulator: str | None = None,
) -> Replay:
    """A model file (MJCF or URDF) over a recording: what `adaptsim replay` runs.

    Args:
        asked: Yardsticks; where None, whole trials are among them only of a machine that follows
            commands.
        simulator: `tree` or `mujoco`; None: see `choice`.
    """
    choice = choose(data, model, simulator, horizon)
    if choice.simulator == "mujoco":
        return by_mujoco(choice, horizon)
    machine = load(data, model)
    if asked is None:
        asked = NAMES if follows(machine) else (STRETCHES, TORQUE)
    found = replay(machine, horizon, asked=asked)
    return dataclasses.replace(
        found, notes=(*found.notes, *machine.log.notes, *machine.notes, *suspected(machine))
    )


def recommended(
    data: Data,
    declared: str | File | None,
    simulator: str,
    spans: Mapping[str, float],
    without: Sequence[str] = (),
    apart: Mapping[File, Span] | None = None,
) -> Callable[[File], Table]:
    """What runs the files of a folder beside the declared one (`diagnosis.recommended`), as
    `adaptsim replay` does.

    Args:
        declared: None: as meta.toml says.
        without: Trials that are left out.
        apart: Folders of the same files, each made without a part of the log, over which alone
            they are run. None: those of the folder over all of it.
    """
    read, known = cache(partial(load, data)), dict[tuple[Any, ...], Replay]()

    def simulated(model: str | File | None, span: float, part: Span | None) -> Replay:
        if simulator == "mujoco":
            return replay_files(model, data, span, (STRETCHES,), simulator)
        machine, most = read(model), REPORT.run_stretches
        if part and apart:
            trial, *ends = part
            tracks = tuple(t.between(*ends) for t in machine.tracks if t.name == trial)
            machine, most = dataclasses.replace(machine, tracks=tracks), most // len(apart)
        same = (_simulated_by(machine), span, part)
        if same not in known:
            known[same] = replay(machine, span, most=max(most, 1), roughly=True)
        return known[same]

    def run(model: File | None, span: float) -> FileReplay:
        found = []
        for folder, part in (apart or {None: None}).items():
            file = folder / model.name if folder and model else model or declared
            found.append(simulated(file, span, part))
        one = found[0]
        taken = [r.trial_names[k] not in without for r in found for k in r.trial]
        error = np.concatenate([r.error for r in found])[taken]
        nothing = np.concatenate([np.minimum(r.line, r.still) for r in found])[taken]
        units = tuple("rad" if kind == "hinge" else "m" for kind in one.kinds)
        return FileReplay(one.joint_names, units, error, nothing)

    def verify(folder: File) -> Table:
        files = [folder / name for name in WRITTEN if (folder / name).exists()]
        if simulator == "mujoco":
            files = [file for file in files if file.suffix == ".xml"]
        return joint_errors(run, files, spans)

    return verify


def _simulated_by(machine: Machine) -> bytes:
    """What a simulation of a machine reads of its file: two files with the same need one run."""
    return pickle.dumps(
        (
            machine.tree,
            machine.actuator,
            machine.gear,
            machine.declared,
            machine.ties,
            machine.gives,
        )
    )


def follows(machine: Machine) -> bool:
    """Whether its actuators are told where to be."""
    return bool(np.any(machine.actuator[2] != 0.0))


def by_mujoco(choice: Choice, horizon: float) -> Replay:
    """A model file over a recording by MuJoCo itself; a base that moves is told beside the
    joints.
    """
    source, log = choice.source, choice.log
    if source is None or log is None:
        raise ValueError("a choice of mujoco has read its files")
    found = mujoco_replayed(source, log, horizon)
    remarks = (
        *_shorter(horizon, found.span, max(float(np.ptp(t.time)) for t in log.trials)),
        f"simulated by MuJoCo at the file's own step: {choice.why}",
    )
    s, model, names = found.stretches, found.stepped_model.model, log.joint_names
    slides = {
        model.joint(k).name
        for k in range(model.njnt)
        if model.jnt_type[k] == int(mujoco.mjtJoint.mjJNT_SLIDE)
    }
    kinds = tuple("slide" if name in slides else "hinge" for name in names)
    n, error = len(names), found.error
    measured, mask, simulated = (
        s.measured[..., :n],
        s.is_measured[..., :n].astype(float),
        found.simulated,
    )
    if found.base is not None:
        base = np.median(found.base, 0)
        remarks = (
            *remarks,
            f"the base errs by {base[0]:.3g} m and {base[1]:.3g} rad (medians over stretches)",
        )
    if s.count < found.total:
        remarks = (*remarks, f"{s.count} of {found.total} stretches, evenly spread")
    if not n and found.base is not None:  # nothing but a body that flies
        names, kinds, error = ("base, place", "base, turn"), ("slide", "hinge"), found.base
        measured = simulated = mask = np.zeros((*s.time.shape, 2))
    line, still = doing_nothing(s.time, measured, mask)
    return Replay(
        names,
        kinds,
        s.names,
        s.trial,
        error,
        s.time,
        measured,
        simulated,
        mask,
        found.span,
        (*remarks, *log.notes, *source.notes, *found.stepped_model.notes),
        line,
        still,
    )


def suspected(machine: Machine) -> tuple[str, ...]:
    """What `diagnose` refuses or warns of: columns and units that the motion contradicts. A
    yardstick only tells.
    """
    try:
        return tuple(f.message for f in check_conventions(machine))
    except BadInput as error:
        return (str(error).removesuffix(f"; {AS_DECLARED}"),)
