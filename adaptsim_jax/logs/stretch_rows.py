"""Which rows of a log make stretches that are simulated: consecutive ones, none over a gap in time,
and of these about so many as are wanted.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.criteria import UNBROKEN

Row = tuple[int, int]
"""A trial and the first row there of a stretch."""


@dataclass(frozen=True)
class TrialSpans:
    """Rows of a trial that stretches may be made of: time [T] s; q [T, n] rad or m, NaN where an
    angle is missing; last [T]: the last row of a stretch that begins at each; stride: rows from one
    that is compared to the next.
    """

    time: np.ndarray
    q: np.ndarray
    last: np.ndarray
    stride: int = 1


@dataclass(frozen=True)
class StretchRows:
    """W stretches: trial [W], first and last [W] row of each there, stride [W] rows."""

    trial: np.ndarray
    first: np.ndarray
    last: np.ndarray
    stride: np.ndarray

    def compared(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows [W, L] that are compared, and whether they are the stretch's own [W, L]: one shorter
        than the longest has its last row again.
        """
        count = ((self.last - self.first) // self.stride)[:, None]
        k = np.arange(count.max() + 1)
        rows = self.first[:, None] + self.stride[:, None] * np.minimum(k, count)
        return rows, k <= count


def stretch_rows(
    trials: Sequence[TrialSpans], horizon: float, most: int, where: str = ""
) -> StretchRows:
    """Consecutive stretches of `horizon` s of all trials, at most about `most`.

    Raises BadInput where no trial holds a whole one, with `where` in front.
    """
    every = [[(k, first) for first in _first_rows(t)] for k, t in enumerate(trials)]
    some = spread([part for part in every if part], most)
    if not some:
        raise BadInput(
            f"{where}no trial has an unbroken stretch of {horizon:g} s; give a shorter --horizon "
            "or longer trials"
        )
    trial, first = np.array(some).T
    last = np.array([trials[k].last[row] for k, row in some])
    return StretchRows(trial, first, last, np.array([trials[k].stride for k in trial]))


def spread(parts: Sequence[Sequence[Row]], most: int) -> list[Row]:
    """About `most` stretches of all parts, evenly spread, and where there is room at least one of
    each part: a trial that is left out tells nothing.
    """
    if len(parts) > most:
        parts = [[row for part in parts for row in part]]
    total = sum(map(len, parts))
    chosen = []
    for part in parts:
        count = max(1, round(min(1.0, most / total) * len(part)))
        places = np.linspace(0, len(part) - 1, count).round().astype(int)
        chosen += [part[i] for i in np.unique(places)]
    return chosen


def broken(time: np.ndarray) -> np.ndarray:
    """[T-1]: whether a gap follows a row of a trial; time [T] s."""
    steps = np.diff(time)
    return steps > max(UNBROKEN.min_gap_rows * float(np.median(steps)), UNBROKEN.min_gap)


def _first_rows(trial: TrialSpans) -> list[int]:
    """Where consecutive stretches begin, over no gap, with enough of their angles read."""
    gaps = np.flatnonzero(broken(trial.time))
    observed = np.isfinite(trial.q).mean(1) if trial.q.shape[1] else np.ones(len(trial.time))
    begins, at = [], 0
    while at < len(trial.time) and trial.last[at] < len(trial.time):
        end = int(trial.last[at])
        inside = gaps[(gaps >= at) & (gaps < end)]
        if len(inside):
            at = int(inside[-1]) + 1
            continue
        if end > at and observed[at : end + 1].mean() > UNBROKEN.min_read_share:
            begins.append(at)
        at = max(end, at + 1)
    return begins
