"""Rows that were read evenly and stamped unevenly: by how much the angles follow the unevenness of
the stamps.

A cubic through the two rows on each side foretells an angle at its stamp. If rows were read evenly,
a stamp that is off by d misses by the speed times d, in the pattern of the stamps; if the stamps
are right, by noise that knows nothing of them. One regression over all joints and trials tells the
two apart. NumPy alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

LEAST_JITTER = 1e-3
"""Of an interval: a clock this even is even."""
EVEN, SURE = 0.7, 10.0
"""Share of the stamps' unevenness that the angles must not follow for rows to count as even, and in
standard errors of it.
"""
STENCIL = (-2, -1, 1, 2)


@dataclass(frozen=True)
class Jitter:
    """`times`: even times of each trial `[T]`; `size`: standard deviation of the stamps about them,
    s; `share` of it that the angles do not follow.
    """

    times: tuple[np.ndarray, ...]
    size: float
    share: float


def jitter(trials: Sequence[tuple[np.ndarray, np.ndarray]]) -> Jitter | None:
    """Of trials (time [T] s, q [T, n], NaN where missing); None where stamps are even, or right, or
    where that cannot be told.
    """
    evens = [e for time, _ in trials if (e := even(time)) is not None]
    if len(evens) < len(trials):
        return None
    off = [time - e for (time, _), e in zip(trials, evens, strict=True)]
    step = float(np.median(np.concatenate([np.diff(time) for time, _ in trials])))
    size = float(np.std(np.concatenate(off)))
    if size < LEAST_JITTER * step:
        return None
    top = bottom = whole = 0.0
    count = 0
    for (time, q), e, d in zip(trials, evens, off, strict=True):
        for j in range(q.shape[1]):
            if len(time) < 10 or not np.all(np.isfinite(q[:, j])):
                continue
            missed = _missed(time, q[:, j])
            x = _missed(time, -np.gradient(q[:, j], e) * d)
            gain = 1.0 / max(
                float(np.median(np.abs(missed))) ** 2, 1e-24
            )  # joints count by their own noise
            top += gain * float(x @ missed)
            bottom += gain * float(x @ x)
            whole += gain * float(missed @ missed)
            count += len(x)
    if not bottom > 0.0 or count < 50:
        return None
    share = top / bottom
    error = np.sqrt(max(whole - share * top, 1e-300) / count / bottom)
    if share < EVEN or share > 2.0 - EVEN or share < SURE * error:
        return None
    return Jitter(tuple(e for e in evens if e is not None), size, share)


def even(time: np.ndarray) -> np.ndarray | None:
    """Even times of rows of which some may be missing, nearest to their stamps; None where stamps
    are farther off than half a row.
    """
    step = float(np.median(np.diff(time)))
    if len(time) < 3 or not step > 0:
        return None
    whole = round(float(time[-1] - time[0]) / step)
    if whole == len(time) - 1:
        place = np.arange(len(time))
    else:
        place = np.cumsum(np.round(np.diff(time, prepend=time[0]) / step))
    if np.any(np.diff(place) < 1):
        return None
    slope, begin = np.polyfit(place, time, 1)
    out = begin + slope * place
    if np.max(np.abs(time - out)) < 2.0 * step:
        return out
    return None


def _missed(time: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Values `[T - 4]` less what the cubic through their two neighbours on each side foretells."""
    middle = np.arange(2, len(time) - 2)
    t = np.stack([time[middle + k] for k in STENCIL])
    out = x[middle].copy()
    for a in range(4):
        weight = np.ones(len(middle))
        for b in range(4):
            if a != b:
                weight *= (time[middle] - t[b]) / (t[a] - t[b])
        out -= weight * x[middle + STENCIL[a]]
    return out
