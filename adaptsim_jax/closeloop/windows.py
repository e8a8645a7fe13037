"""Trials cut into short windows with a free initial state each (multiple shooting; Bock, 1983), as arrays.

Commands stay with their trials, because command effects act on a whole trial; a window knows its rows, and what reached
the joint over each of its steps is gathered from the trial's impulse inside the compiled program.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import jax
import numpy as np

from adaptsim_jax.errors import BadInput


class Measured(Protocol):
    """What is needed of a trial: `time [T]` s, `q [T, n]` rad, `v [T, n]` rad/s or None, `torque [T, U]` N m."""

    time: np.ndarray
    q: np.ndarray
    v: np.ndarray | None
    torque: np.ndarray


@dataclass(frozen=True)
class Windows:
    """Arrays of one recording, a pytree. Padding has weight 0 and steps of no duration.

    time [N, T] s, torque [N, T, U] N m, motion_q, motion_v [N, T, n]: trials, padded at the end;
    trial [W], rows [W, L+1]: where the windows lie; measured, weight [W, L+1, Y] (weight in 1 / standard deviation);
    start [W, S]: initial states from the data; substeps: integration steps in a step of a window.
    """

    time: np.ndarray
    torque: np.ndarray
    motion_q: np.ndarray
    motion_v: np.ndarray
    trial: np.ndarray
    rows: np.ndarray
    measured: np.ndarray
    weight: np.ndarray
    start: np.ndarray
    substeps: int

    @property
    def times(self) -> np.ndarray:
        """Time of each boundary `[W, L+1]` s."""
        return np.take_along_axis(self.time[self.trial], self.rows, 1)

    @property
    def dt(self) -> np.ndarray:
        """Duration of each step `[W, L]` s; zero for padding."""
        return np.diff(self.times, axis=1)

    @property
    def real(self) -> np.ndarray:
        """`[W]` False for windows that only fill up the shape."""
        return (np.asarray(self.weight) > 0).any((1, 2))

    @property
    def trials(self) -> int:
        return self.time.shape[0]


jax.tree_util.register_dataclass(
    Windows,
    data_fields=[
        "time", "torque", "motion_q", "motion_v", "trial", "rows", "measured", "weight", "start",
    ],
    meta_fields=["substeps"],
)  # fmt: skip


def cut_windows(
    trials: Sequence[Measured],
    sigma: np.ndarray,
    *,
    duration: float = 0.5,
    max_rate: float = 250.0,
    max_step: float = 5.1e-3,
    motions: Sequence[tuple[np.ndarray, np.ndarray]] | None = None,
    pad_windows: int = 16,
    use_velocity: bool = True,
) -> Windows:
    """Cut `trials` into windows of about `duration` s.

    sigma: `[2 n]` standard deviations of positions [rad] and velocities [rad/s]; NaN samples and channels of infinite
    sigma have no weight. Rows faster than `max_rate` Hz are merged (torque by impulse, every k-th sample kept).
    motions: smoothed `(q [T, n], v [T, n])` per trial, for initial states; local cubics of the data where None.
    Windows never span a gap of over five median rows. Raises BadInput where a trial is too short.
    """
    if not trials:
        raise BadInput("no trials to cut into windows; give at least one")
    dt = float(np.median(np.concatenate([np.diff(t.time) for t in trials])))
    stride = max(1, int(np.ceil(1.0 / (max_rate * dt) - 0.05)))
    motions = motions or [local_motion(t.time, t.q, t.v) for t in trials]
    steps = max(4, round(duration / (dt * stride)))
    places = [_places(t.time, stride, steps, dt) for t in trials]
    has_velocity = use_velocity and all(t.v is not None for t in trials)
    trial = np.concatenate([np.full(len(p), i) for i, p in enumerate(places)]).astype(np.int32)
    rows = np.concatenate(places).astype(np.int32)
    pieces = [_measured(t, p, sigma, has_velocity) for t, p in zip(trials, places, strict=True)]
    measured, weight = (np.concatenate(z) for z in zip(*pieces, strict=True))
    start = np.concatenate(
        [np.concatenate([q[p[:, 0]], v[p[:, 0]]], 1) for (q, v), p in zip(motions, places, strict=True)]
    )
    rest = (-len(rows)) % pad_windows
    widest = max(float(np.diff(t.time[p], axis=1).max()) for t, p in zip(trials, places, strict=True))
    pad = lambda z: np.concatenate([z, np.zeros((rest, *z.shape[1:]), z.dtype)])
    return Windows(
        *_stacked(trials, motions),
        trial=pad(trial),
        rows=np.concatenate([rows, np.repeat(rows[:1], rest, 0)]),
        measured=pad(measured),
        weight=pad(weight),
        start=np.concatenate([start, np.repeat(start[:1], rest, 0)]),
        substeps=max(1, int(np.ceil(widest / max_step - 1e-6))),
    )


def _places(time: np.ndarray, stride: int, steps: int, dt: float) -> np.ndarray:
    """Rows at the boundaries of a trial's windows `[w, L+1]`; the last window of a stretch repeats its end row."""
    if len(time) < 3:
        raise BadInput(f"a trial of {len(time)} rows is too short to fit; give at least 3")
    gaps = np.flatnonzero(np.diff(time) > 5 * dt)
    edges = np.concatenate([[0], gaps + 1, [len(time)]])
    windows = []
    for first, last in pairwise(edges):
        kept = np.arange(first, last, stride)
        count = max(1, round((len(kept) - 1) / steps))
        for k in range(count):
            part = kept[k * steps : min(len(kept), (k + 1) * steps + 1)]
            if len(part) >= 4:
                windows.append(np.concatenate([part, np.repeat(part[-1], steps + 1 - len(part))]))
    if not windows:
        raise BadInput("a trial has no unbroken stretch of 4 rows; record without gaps")
    return np.array(windows)


def _measured(trial: Measured, places: np.ndarray, sigma: np.ndarray, has_velocity: bool):
    """Samples and weights `[w, L+1, Y]`; a row that two windows share counts half in each."""
    y = trial.q if not has_velocity or trial.v is None else np.concatenate([trial.q, trial.v], 1)
    count = y.shape[1]
    inverse = np.where(np.isfinite(sigma[:count]) & (sigma[:count] > 0), 1.0 / sigma[:count], 0.0)
    picked = y[places]
    weight = np.where(np.isfinite(picked), inverse, 0.0)
    weight[:, 1:] *= (np.diff(places, axis=1) > 0)[..., None]
    uses = np.bincount(places[:, 0], minlength=len(y)) + np.bincount(places.max(1), minlength=len(y))
    half = np.sqrt(0.5)
    weight[:, 0] *= np.where(uses[places[:, 0]] > 1, half, 1.0)[:, None]
    weight *= np.where((places == places.max(1, keepdims=True)) & (uses[places] > 1), half, 1.0)[..., None]
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
    out_q, out_v = np.empty_like(q), np.empty_like(q)
    count = min(2 * half + 1, len(time))
    for i in range(len(time)):
        first = min(max(i - half, 0), len(time) - count)
        near = slice(first, first + count)
        s = time[near] - time[i]
        width = max(abs(s[0]), abs(s[-1]))
        powers = (s[:, None] / width) ** np.arange(4)
        design, target = powers, q[near]
        if v is not None and np.isfinite(v[near]).all():
            slopes = np.arange(4) * (s[:, None] / width) ** np.maximum(np.arange(4) - 1, 0)
            design, target = np.concatenate([design, slopes]), np.concatenate([target, v[near] * width])
        keep = np.isfinite(target).all(1)
        coef = np.linalg.lstsq(design[keep], target[keep], rcond=None)[0]
        out_q[i], out_v[i] = coef[0], coef[1] / width
    return out_q, out_v
