"""Targets as they were sent: a driver that cuts steps short sends less than what was recorded."""

from __future__ import annotations

import numpy as np


def within(target: np.ndarray, q: np.ndarray, most: float) -> np.ndarray:
    """A target `[T]` that is sent no farther than `most` from where the joint is, `q [T]`."""
    return q + np.clip(target - q, -most, most)


def limited(time: np.ndarray, target: np.ndarray, q: np.ndarray, rate: float) -> np.ndarray:
    """A target `[T]` at `time [T]` s that is sent by steps of at most `rate` (rad/s or m/s) times
    the time of a row, from where the joint is at first.
    """
    if len(target) < 2:
        return target
    step = rate * np.diff(time, prepend=2 * time[0] - time[1])
    out = np.empty_like(target)
    first = q[np.isfinite(q)]
    last = float(first[0]) if len(first) else float(target[0])
    for k, (u, d) in enumerate(zip(target.tolist(), step.tolist(), strict=True)):
        last = min(max(u, last - d), last + d) if u == u else last
        out[k] = last
    return out
