"""A recording cut into pieces of a few seconds, and its motion, smoothed, that is imposed on the
joints which are not simulated.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from scipy import signal

from adaptsim_jax.logs.log import Log
from adaptsim_jax.logs.noise import local_motion, sensor_noise
from adaptsim_jax.simulators.closed_loop.criteria import CLOSED_LOOP
from adaptsim_jax.simulators.closed_loop.law import Servo


@dataclass(frozen=True)
class Trial:
    """A trial of servos.

    Args:
        name: Of its file.
        time: [T] s from its first row.
        q: [T, n] rad.
        target: [T, n] rad or rad/s, held from row to row.
        begins: {joint: rad} of joints that are tied to others.
        others: {actuator: [T]} commands of actuators that are no servo of a joint.
        speed: [n] rad/s at its first row, where it is cut from another; else its own rows tell.
        begin: s of its first row in the trial that it is cut from.
    """

    name: str
    time: np.ndarray
    q: np.ndarray
    target: np.ndarray
    begins: dict[str, float] = field(default_factory=dict)
    others: dict[str, np.ndarray] = field(default_factory=dict)
    speed: np.ndarray | None = None
    begin: float = 0.0

    def start_speed(self) -> np.ndarray:
        """Speeds [n] at the first row, rad/s: 0 of a trial that begins at rest."""
        if self.speed is not None:
            return self.speed
        if begins_at_rest(self.q):
            return np.zeros(self.q.shape[1])
        return smooth(self.time, self.q).v[0]

    def between(self, first: int, last: int) -> "Trial":
        """Its rows from `first` to `last`, with the speed that all of its rows tell."""
        rows = slice(first, last + 1)
        others = {name: u[rows] for name, u in self.others.items()}
        speed = smooth(self.time, self.q).v[first] if first else self.start_speed()
        begin = float(self.time[first])
        cut = self.time[rows] - begin, self.q[rows], self.target[rows]
        return Trial(self.name, *cut, self.begins, others, speed, begin)

    def first(self, rows: int) -> "Trial":
        """Its first rows."""
        others = {name: u[:rows] for name, u in self.others.items()}
        cut = self.time[:rows], self.q[:rows], self.target[:rows]
        return Trial(self.name, *cut, self.begins, others, self.speed)


@dataclass(frozen=True)
class TrialMotion:
    """Angles, speeds and accelerations [T, n] of a trial."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray


def trials_of(log: Log, servos: Sequence[Servo]) -> tuple[Trial, ...]:
    """The trials of a log as its servos see them."""
    column = {name: k for k, name in enumerate(log.input_names)}
    joints = [s.joint for s in servos]
    commands = [column[s.command] for s in servos]
    factor, offset = np.array([s.target for s in servos]).T
    low, high = np.array([s.command_range for s in servos]).T
    coupled = [j for j in range(len(log.joint_names)) if j not in joints]
    other_inputs = [name for name in log.input_names if name not in {s.command for s in servos}]
    out = []
    for trial in log.trials:
        begins = {log.joint_names[j]: float(np.nan_to_num(trial.q[0, j])) for j in coupled}
        held = _hold_commands(trial.u)
        out.append(
            Trial(
                trial.name,
                trial.time - trial.time[0],
                _fill_angles(trial.time, trial.q[:, joints]),
                np.clip(held[:, commands], low, high) * factor + offset,
                begins,
                {name: held[:, column[name]] for name in other_inputs},
            )
        )
    return tuple(out)


def _hold_commands(u: np.ndarray) -> np.ndarray:
    """Commands of which a missing row holds the one before."""
    rows = np.where(np.isfinite(u), np.arange(len(u))[:, None], 0)
    rows = np.maximum.accumulate(rows, 0)
    return np.nan_to_num(np.take_along_axis(u, rows, 0))


def _fill_angles(time: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Angles, where they were not read those of local cubics."""
    if np.isfinite(q).all():
        return q
    return np.where(np.isfinite(q), q, local_motion(time, q, None)[0])


def smooth(time: np.ndarray, x: np.ndarray) -> TrialMotion:
    """Local cubics over `CLOSED_LOOP.smooth` s, at least five rows."""
    dt = float(np.median(np.diff(time)))
    rows = max(5, 2 * round(0.5 * CLOSED_LOOP.smooth / dt) + 1)
    rows = min(rows, (len(time) - 1) // 2 * 2 + 1)
    order = min(3, rows - 1)
    parts: list[Any] = [
        signal.savgol_filter(x, rows, order, deriv=k, delta=dt, axis=0, mode="interp")
        for k in (0, 1, 2)
    ]
    return TrialMotion(*parts)


def imposed_motion(trial: Trial, simulated: TrialMotion | None = None) -> TrialMotion:
    """The motion that is imposed: the measured one, or a simulated one and the smoothed rest."""
    if simulated is None:
        return smooth(trial.time, trial.q)
    remainder = smooth(trial.time, trial.q - simulated.q)
    # mean accelerations: at the rows they would be locked to the targets' steps
    mean = np.gradient(simulated.v, trial.time, axis=0)
    return TrialMotion(simulated.q + remainder.q, simulated.v + remainder.v, mean + remainder.a)


def pieces_of(
    trials: Sequence[Trial], longest: float = CLOSED_LOOP.longest
) -> tuple[tuple[int, int, int], ...]:
    """(trial, first row, last row) of pieces of about `longest` s, cut where the machine is
    slowest.

    Of very many those remain that move most.
    """
    out, most = [], round(CLOSED_LOOP.pieces * CLOSED_LOOP.longest / longest)
    for k, trial in enumerate(trials):
        speed = np.abs(smooth(trial.time, trial.q).v).max(1)
        edges = _edges(trial.time, speed, longest)
        out += [(k, a, b) for a, b in pairwise(edges) if b - a >= 8]
    if len(out) > most:
        moves = [np.std(trials[k].q[a:b], 0).sum() for k, a, b in out]
        chosen = np.sort(np.argsort(moves)[-most:])
        out = [out[i] for i in chosen]
    return tuple(out)


def _edges(time: np.ndarray, speed: np.ndarray, longest: float) -> list[int]:
    """Rows between which a trial is cut: near even times, where it is slowest."""
    span = float(time[-1])
    count = max(1, int(np.ceil(span / longest)))
    edges = [0]
    for k in range(1, count):
        candidates = np.flatnonzero(np.abs(time - span * k / count) < 0.2 * longest)
        edges.append(int(candidates[np.argmin(speed[candidates])]))
    return [*edges, len(time) - 1]


def groups_of(pieces: Sequence[tuple[int, int, int]], trials: int) -> tuple[np.ndarray, ...]:
    """Pieces that are left out together: those of a trial where there are eight or more."""
    own = np.array([k for k, _, _ in pieces])
    if trials >= 8:
        return tuple(np.flatnonzero(own == k) for k in np.unique(own))
    return tuple(np.array([i]) for i in range(len(pieces)))


def begins_at_rest(q: np.ndarray) -> bool:
    """Whether the first rows [4, n] of a trial stand still."""
    return bool(np.abs(q[:4] - q[0]).max() < CLOSED_LOOP.rest)


def encoder_noise(trials: Sequence[Trial]) -> np.ndarray:
    """Noise [n] of the angles: by differences, at least the encoder's step over the root of 12."""
    by_rows = sensor_noise([t.q for t in trials])
    steps = np.concatenate([np.abs(np.diff(t.q, axis=0)) for t in trials])
    steps = np.where(steps > 1e-9, steps, np.nan)
    with np.errstate(all="ignore"):
        step = np.array([_low(s) for s in steps.T])
    return np.maximum(np.maximum(by_rows, step / np.sqrt(12.0)), CLOSED_LOOP.min_noise)


def _low(steps: np.ndarray) -> float:
    some = steps[np.isfinite(steps)]
    return float(np.percentile(some, 1)) if len(some) else 0.0
