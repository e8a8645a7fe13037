"""Trials cut into short windows with a free initial state each (multiple shooting; Bock, 1983), as arrays.

Commands stay with their trials, because command effects act on a whole trial; a window knows its rows, and what reached
the joint over each of its steps is gathered from the trial's impulse inside the compiled program.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple, Protocol

import jax
import numpy as np

from adaptsim_jax.core.errors import BadInput


class Measured(Protocol):
    """What is needed of a trial: `time [T]` s, `q [T, n]` rad, `v [T, n]` rad/s or None, `torque [T, U]` N m."""

    @property
    def time(self) -> np.ndarray: ...
    @property
    def q(self) -> np.ndarray: ...
    @property
    def v(self) -> np.ndarray | None: ...
    @property
    def torque(self) -> np.ndarray: ...


@dataclass(frozen=True)
class Windows:
    """Arrays of one recording, a pytree. Padding has weight 0 and steps of no duration.

    time [N, T] s, torque [N, T, U] N m, motion_q, motion_v [N, T, n]: trials, padded at the end;
    trial [W], rows, times [W, L+1]: where the windows' boundaries lie, `rows` being the row that holds at that time;
    measured, weight [W, L+1, Y] (weight in 1 / standard deviation); start [W, S]: initial states from the data;
    clock [N]: s to add to a trial's time for what goes on between trials (zero until `nuisance/phase.py` finds it);
    substeps: `[]` integration steps in a step of a window.
    """

    time: np.ndarray
    torque: np.ndarray
    motion_q: np.ndarray
    motion_v: np.ndarray
    trial: np.ndarray
    rows: np.ndarray
    times: np.ndarray
    measured: np.ndarray
    weight: np.ndarray
    start: np.ndarray
    clock: np.ndarray
    substeps: np.ndarray

    @property
    def dt(self) -> np.ndarray:
        """Duration of each step `[W, L]` s; zero for padding."""
        return np.diff(self.times, axis=1)

    @property
    def real(self) -> np.ndarray:
        """`[W]` False for windows that only fill up the shape."""
        return np.any(np.asarray(self.weight) > 0, axis=(1, 2))

    @property
    def trials(self) -> int:
        return self.time.shape[0]


jax.tree_util.register_dataclass(
    Windows,
    data_fields=[
        "time", "torque", "motion_q", "motion_v", "trial", "rows", "times", "measured", "weight", "start", "clock",
        "substeps",
    ],
    meta_fields=[],
)  # fmt: skip


class _Cut(NamedTuple):
    """Windows of one trial: boundaries `[w, L+1]` as held row, time from its start, and whether a sample is there."""

    rows: np.ndarray
    times: np.ndarray
    sampled: np.ndarray


def cut_windows(
    trials: Sequence[Measured],
    sigma: np.ndarray,
    *,
    duration: float = 0.5,
    max_rate: float = 250.0,
    max_step: float = 5.1e-3,
    motions: Sequence[tuple[np.ndarray, np.ndarray]] | None = None,
    pad_windows: int = 16,
    most_windows: int = 96,
    use_velocity: bool = True,
) -> Windows:
    """Cut `trials` into windows of about `duration` s.

    sigma: `[2 n]` standard deviations of positions [rad] and velocities [rad/s]; NaN samples and channels of infinite
    sigma have no weight. Rows faster than `max_rate` Hz are merged (torque by impulse, every k-th sample kept); a step
    that is unusually long is split. Integration steps are at most about `max_step` s.
    motions: smoothed `(q [T, n], v [T, n])` per trial, for initial states; local cubics of the data where None.
    Windows never span a gap of over 0.1 s and five median rows. Of a long recording `most_windows` are kept, evenly spread
    over each trial: the cost of a fit grows with them, what it can tell hardly does. Raises BadInput where a trial is too
    short.
    """
    if not trials:
        raise BadInput("no trials to cut into windows; give at least one")
    dt = float(np.median(np.concatenate([np.diff(t.time) for t in trials])))
    stride = max(1, int(np.ceil(1.0 / (max_rate * dt) - 0.05)))
    motions = motions or [local_motion(t.time, t.q, t.v) for t in trials]
    steps = max(4, round(duration / (dt * stride)))
    substeps = max(1, int(np.ceil(dt * stride / max_step - 0.05)))
    seen = [np.asarray(np.isfinite(t.q).all(1)) for t in trials]
    longest = 1.3 * substeps * max_step
    cuts = [_cut(t.time - t.time[0], ok, stride, steps, dt, longest) for t, ok in zip(trials, seen, strict=True)]
    share = min(1.0, most_windows / sum(len(c.rows) for c in cuts))
    cuts = [_thinned(c, max(1, round(share * len(c.rows)))) for c in cuts]
    has_velocity = use_velocity and all(t.v is not None for t in trials)
    trial = np.concatenate([np.full(len(c.rows), i) for i, c in enumerate(cuts)]).astype(np.int32)
    pieces = [_measured(t, c, sigma, has_velocity) for t, c in zip(trials, cuts, strict=True)]
    measured, weight = (np.concatenate(z) for z in zip(*pieces, strict=True))
    first = [c.rows[:, 0] for c in cuts]
    start = [np.concatenate([q[k], v[k]], 1) for (q, v), k in zip(motions, first, strict=True)]
    rest = (-len(trial)) % pad_windows
    empty = lambda z: np.concatenate([z, np.zeros((rest, *z.shape[1:]), z.dtype)])
    again = lambda z: np.concatenate([*z, np.repeat(z[0][:1], rest, 0)])
    stacked = _stacked(trials, motions)
    return Windows(
        *stacked,
        trial=empty(trial),
        rows=again([c.rows for c in cuts]).astype(np.int32),
        times=again([c.times for c in cuts]),
        measured=empty(measured),
        weight=empty(weight),
        start=again(start),
        clock=np.zeros(len(stacked[0])),
        substeps=np.asarray(substeps),
    )


def _cut(time: np.ndarray, seen: np.ndarray, stride: int, steps: int, dt: float, longest: float) -> _Cut:
    """Boundaries of a trial's windows, of rows `seen` or not; a window that ends early repeats its last boundary."""
    if len(time) < 4:
        raise BadInput(f"a trial of {len(time)} rows is too short to fit; give at least 4")
    gaps = np.flatnonzero(np.diff(time) > max(5 * dt, 0.1))
    edges = np.concatenate([[0], gaps + 1, [len(time)]])
    windows = []
    for first, last in pairwise(edges):
        kept = np.arange(first, last, stride)
        at, sampled = _split_long(time[kept], longest)
        usable = sampled.copy()
        usable[sampled] = seen[kept]
        for part in _parts(usable, steps):
            index = np.concatenate([part, np.repeat(part[-1], steps + 1 - len(part))])
            fresh = np.arange(steps + 1) < len(part)
            windows.append((at[index], sampled[index] & fresh))
    if not windows:
        raise BadInput("a trial has no unbroken stretch of 4 rows; record without gaps")
    times, sampled = (np.array(z) for z in zip(*windows, strict=True))
    rows = np.clip(np.searchsorted(time, times + 1e-9, side="right") - 1, 0, len(time) - 1)
    return _Cut(rows, times, sampled)


def _thinned(cut: _Cut, count: int) -> _Cut:
    """`count` of a trial's windows, evenly spread."""
    keep = np.unique(np.linspace(0, len(cut.rows) - 1, count).round().astype(int))
    return _Cut(*(z[keep] for z in cut))


def _split_long(at: np.ndarray, longest: float) -> tuple[np.ndarray, np.ndarray]:
    """Times with steps over `longest` split evenly, and which of them are samples."""
    pieces = np.maximum(1, np.ceil(np.diff(at) / longest - 1e-6)).astype(int)
    new = [t + (u - t) * np.arange(k) / k for t, u, k in zip(at[:-1], at[1:], pieces, strict=True)]
    sampled = np.concatenate([np.arange(k) == 0 for k in pieces] + [[True]])
    return np.concatenate([*new, at[-1:]]), sampled


def _parts(usable: np.ndarray, steps: int) -> list[np.ndarray]:
    """Consecutive stretches of `steps` steps; a rest of under half a window is dropped, unless it is all there is. Each begins
    with a usable sample where there is one: on which side of a play a stretch begins, only that can tell."""
    count, at, parts = len(usable), 0, []
    while at < count - 1:
        at += int(np.argmax(usable[at:]))
        parts.append(np.arange(at, min(at + steps + 1, count)))
        at += steps
    long = [p for p in parts if len(p) > steps // 2 + 1]
    return long or [p for p in parts[:1] if len(p) >= 4]


def _measured(trial: Measured, cut: _Cut, sigma: np.ndarray, has_velocity: bool) -> tuple[np.ndarray, np.ndarray]:
    """Samples and weights `[w, L+1, Y]`; a sample that two windows share counts half in each."""
    y = trial.q if not has_velocity or trial.v is None else np.concatenate([trial.q, trial.v], 1)
    count = y.shape[1]
    inverse = np.where(np.isfinite(sigma[:count]) & (sigma[:count] > 0), 1.0 / sigma[:count], 0.0)
    picked = y[cut.rows]
    uses = np.zeros(len(y))
    np.add.at(uses, cut.rows[cut.sampled], 1.0)
    share = np.where(cut.sampled, 1.0 / np.sqrt(np.maximum(uses[cut.rows], 1.0)), 0.0)
    weight = np.where(np.isfinite(picked), inverse, 0.0) * share[..., None]
    return np.where(np.isfinite(picked), picked, 0.0), weight


def _stacked(trials: Sequence[Measured], motions) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Trial arrays padded to a multiple of 256 rows and of 4 trials, so that compiled programs repeat."""
    rows = -256 * (-max(len(t.time) for t in trials) // 256)
    count = -4 * (-len(trials) // 4)

    def stack(parts):
        out = np.zeros((count, rows, *parts[0].shape[1:]))
        for i, part in enumerate(parts):
            out[i, : len(part)], out[i, len(part) :] = part, part[-1]
        return out

    torque = [np.where(np.isfinite(t.torque), t.torque, 0.0) for t in trials]
    q, v = zip(*motions, strict=True)
    return stack([t.time - t.time[0] for t in trials]), stack(torque), stack(q), stack(v)


def local_motion(time: np.ndarray, q: np.ndarray, v: np.ndarray | None, half: int = 7) -> tuple[np.ndarray, np.ndarray]:
    """Angle and velocity `[T, n]` by least-squares cubics over `2 half + 1` neighbours (Savitzky-Golay, uneven rows).

    Measured velocities enter the same cubic. Good enough to start a fit; the noise model has a better smoother.
    """
    count = min(2 * half + 1, len(time))
    first = np.clip(np.arange(len(time)) - half, 0, len(time) - count)
    near = first[:, None] + np.arange(count)
    s = time[near] - time[:, None]
    width = np.abs(s).max(1, keepdims=True)
    powers = (s / width)[..., None] ** np.arange(4)
    design, target = powers, q[near]
    if v is not None:
        slopes = np.concatenate([np.zeros_like(powers[..., :1]), np.arange(1, 4) * powers[..., :3]], -1)
        design, target = np.concatenate([design, slopes], 1), np.concatenate([target, v[near] * width[..., None]], 1)
    keep = np.isfinite(target)
    channels = [(np.where(keep, target, 0.0)[..., j], keep[..., j]) for j in range(q.shape[1])]
    coef = np.stack([_cubic(design, y, k) for y, k in channels], -1)  # [T, 4, n]
    return coef[:, 0], coef[:, 1] / width


def _cubic(design: np.ndarray, target: np.ndarray, keep: np.ndarray) -> np.ndarray:
    """Coefficients `[T, 4]` of weighted least squares."""
    kept = design * keep[..., None]
    normal = np.swapaxes(kept, 1, 2) @ design + 1e-9 * np.eye(4)
    return np.linalg.solve(normal, (np.swapaxes(kept, 1, 2) @ target[..., None]))[..., 0]


def folds(trial: np.ndarray, rows: np.ndarray, *, least: int = 3, blocks: int = 6) -> np.ndarray:
    """Fold of each window `[W]`: one a trial, or contiguous blocks of time where there are too few trials."""
    live = np.flatnonzero(rows > 0)
    names = np.unique(trial[live])
    out = np.full(len(trial), -1)
    if len(names) >= least:
        for i, name in enumerate(names):
            out[(trial == name) & (rows > 0)] = i
        return out
    for i, part in enumerate(np.array_split(live, min(blocks, len(live)))):
        out[part] = i
    return out
