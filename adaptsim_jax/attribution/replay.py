"""The yardstick: any model simulated over recordings, from starts fitted to each stretch by plain least squares.

No weighting of an estimator enters: the start of a stretch is the one from which the simulated angles come nearest to the measured
ones, each radian (or metre) counting alike. The error is the root mean square over a stretch, joint by joint.
"""

import dataclasses
from dataclasses import dataclass
from pathlib import Path as File
from typing import Any

import mujoco
import numpy as np

from adaptsim_jax.attribution.catalogue import MACHINE
from adaptsim_jax.attribution.choice import choose
from adaptsim_jax.attribution.conventions import check_conventions
from adaptsim_jax.attribution.estimate import refitted_start
from adaptsim_jax.attribution.linear import linear
from adaptsim_jax.attribution.load import load
from adaptsim_jax.attribution.machine import Machine
from adaptsim_jax.attribution.parameters import Vector
from adaptsim_jax.attribution.paths import ready, run, simulated, starts_of, widened
from adaptsim_jax.attribution.problem import Problem, prepare
from adaptsim_jax.attribution.weights import Fit, Weights, losses
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.log import Log
from adaptsim_jax.logs.quality.contradictions import AS_DECLARED
from adaptsim_jax.mechanisms.spec import Source
from adaptsim_jax.simulators.mujoco.replay import replayed as mujoco_replayed

FAR = 1.0  # rad (m): a stretch of which any joint errs more has run away
ROUNDS = 6


@dataclass(frozen=True)
class Replay:
    """error [W, n] rad or m by stretch and joint; trial [W]; measured and simulated angles [W, L+1, n]; time [W, L+1] s;
    notes: what the reader says of the recording, and what its motion contradicts of the declared columns."""

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

    def told(self) -> dict[str, Any]:
        """What `--json` prints."""
        hinge = [j for j, k in enumerate(self.kinds) if k == "hinge"]
        main = hinge or list(range(len(self.kinds)))
        pool = self.error[:, main]
        unit = lambda j: "rad" if self.kinds[j] == "hinge" else "m"
        some = lambda e: {"median": _median(e), "rms": _rms(e), "ran_away": float(np.mean(e > FAR))}
        return {
            **some(pool), "unit": unit(main[0]), "horizon": self.horizon, "stretches": len(self.error),
            "joints": {name: some(self.error[:, j]) | {"unit": unit(j)} for j, name in enumerate(self.joint_names)},
            "trials": {
                name: some(self.error[self.trial == k][:, main])
                for k, name in enumerate(self.trial_names) if np.any(self.trial == k)
            },
            "notes": list(self.notes),
        }  # fmt: skip


def _median(e: np.ndarray) -> float:
    return float(np.median(e)) if e.size else float("nan")


def _rms(e: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(e)))) if e.size else float("nan")


def replay(machine: Machine, horizon: float = 0.5, vector: Vector | None = None) -> Replay:
    """A machine over its own recording. horizon: s, 0 for each trial in one go. vector: fitted values, or the file's."""
    longest = max(float(t.time[-1] - t.time[0]) for t in machine.tracks)
    span = horizon or 0.98 * min(float(t.time[-1] - t.time[0]) for t in machine.tracks)
    problem = prepare(
        machine.tree,
        machine.tracks,
        MACHINE,
        machine.actuator,
        machine.gear,
        min(span, longest),
        100_000,
        machine.declared,
        ties=machine.ties,
    )
    vector = vector if vector is not None else Vector((), np.zeros(0))
    return replayed(problem, vector, span)


def replayed(problem: Problem, vector: Vector, horizon: float) -> Replay:
    """Of a prepared problem at the values of `vector`."""
    starts = fitted_starts(problem, vector)
    paths = run(problem, vector, starts)
    count, n = len(problem.fold), problem.joints
    s = problem.groups[0].stretches
    rows = s.rows + 1
    out = {k: np.zeros((count, rows, n)) for k in ("measured", "simulated", "seen")}
    for group, path in zip(problem.groups, paths, strict=True):
        own, m = list(group.joints), len(group.joints)
        g = group.stretches
        swap = lambda z: z.transpose(2, 0, 1)[:count]
        out["measured"][..., own], out["seen"][..., own] = swap(g.q), swap(g.seen)
        out["simulated"][..., own] = np.clip(np.nan_to_num(swap(path.sensed[:, :m]), nan=1e6), -1e6, 1e6)
    off = (out["measured"] - out["simulated"]) * out["seen"]
    error = np.sqrt(np.square(off).sum(1) / np.maximum(out["seen"].sum(1), 1))
    return Replay(
        problem.joint_names, problem.kinds, s.names, s.trial[:count], error, s.time.T[:count], out["measured"], out["simulated"],
        out["seen"], horizon,
    )  # fmt: skip


def fitted_starts(problem: Problem, vector: Vector, rounds: int = ROUNDS) -> tuple[np.ndarray, ...]:
    """Starts by plain least squares on the angles, from the smoothed ones."""
    n, width = problem.joints, problem.groups[0].stretches.count
    weights = Weights(np.concatenate([np.ones(n), np.zeros(n)]), np.ones(width))
    made = ready(problem, vector)
    starts = widened(made, starts_of(problem))
    by_lane = lambda starts: losses(problem, simulated(made, starts), weights)
    best = by_lane(starts)
    bare = Vector((), np.zeros(0))
    for _ in range(rounds):
        lin = linear(problem, Fit(vector, starts, weights, best, "", 0), entries=bare.entries)
        moves = [refitted_start(x, r) for x, r in zip(lin.start, lin.residual, strict=True)]
        length = np.ones(width)
        gained = np.zeros(width, bool)
        for _ in range(3):
            trial = tuple(x + length * d for x, d in zip(starts, moves, strict=True))
            loss = by_lane(trial)
            good = (loss < best) & ~gained
            starts = tuple(np.where(good, a, b) for a, b in zip(trial, starts, strict=True))
            fall = np.where(good, 1.0 - loss / np.maximum(best, 1e-300), 0.0)
            best = np.where(good, loss, best)
            gained |= good
            if gained.all():
                break
            length = np.where(gained, 0.0, 0.3 * length)
        if np.max(fall) < 1e-4:
            break
    return starts


def replay_files(
    model: str | File | None, data: str | File, horizon: float = 0.5, simulator: str | None = None
) -> Replay:
    """A model file (MJCF or URDF) over a recording: what `adaptsim replay` runs. simulator: `tree`, `mujoco`, None: see `choice`."""
    found = choose(data, model, simulator, horizon)
    told = (f"simulated by MuJoCo at the file's own step: {found.why}",) if found.simulator == "mujoco" else ()
    if found.simulator == "mujoco" and found.source is not None and found.log is not None:
        return by_mujoco(found.source, found.log, horizon, told)
    machine = load(data, model)
    notes = (*machine.log.notes, *machine.notes, *suspected(machine))
    return dataclasses.replace(replay(machine, horizon), notes=notes)


def by_mujoco(source: Source, log: Log, horizon: float, told: tuple[str, ...] = ()) -> Replay:
    """A model file over a recording by MuJoCo itself; a base that moves is told beside the joints."""
    found = mujoco_replayed(source, log, horizon)
    s, model = found.stretches, found.made.model
    slides = {model.joint(k).name for k in range(model.njnt) if model.jnt_type[k] == int(mujoco.mjtJoint.mjJNT_SLIDE)}
    kinds = tuple("slide" if name in slides else "hinge" for name in log.joint_names)
    names, n, error, measured, simulated = log.joint_names, len(kinds), found.error, s.measured, found.simulated
    measured, seen = measured[..., :n], s.seen[..., :n].astype(float)
    if found.base is not None:
        base = np.median(found.base, 0)
        told = (*told, f"the base errs by {base[0]:.3g} m and {base[1]:.3g} rad (medians over stretches)")
    if s.count < found.total:
        told = (*told, f"{s.count} of {found.total} stretches, evenly spread")
    return Replay(
        names, kinds, s.names, s.trial, error, s.time, measured, simulated, seen, horizon,
        (*told, *log.notes, *source.notes, *found.made.notes),
    )  # fmt: skip


def suspected(machine: Machine) -> tuple[str, ...]:
    """What `diagnose` refuses or warns of: columns and units that the motion contradicts. A yardstick only tells."""
    try:
        return tuple(f.message for f in check_conventions(machine))
    except BadInput as error:
        return (str(error).removesuffix(f"; {AS_DECLARED}"),)
