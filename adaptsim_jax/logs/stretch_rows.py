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
    trials: Sequence[TrialSpans], horizon: float, max_stretches: int, where: str = ""
) -> StretchRows:
    """Consecutive stretches of `horizon` s of all trials, at most about `max_stretches`.

    Raises BadInput where no trial holds a whole one, with `where` in front.
    """
    all_rows = [[(k, first) for first in _first_rows(t)] for k, t in enumerate(trials)]
    chosen = spread([part for part in all_rows if part], max_stretches)
    if not chosen:
        raise BadInput(
            f"{where}no trial has an unbroken stretch of {horizon:g} s; give a shorter --horizon "
            "or longer trials"
        )
    trial, first = np.array(chosen).T
    last = np.array([trials[k].last[row] for k, row in chosen])
    return StretchRows(trial, first, last, np.array([trials[k].stride for k in trial]))


def spread(parts: Sequence[Sequence[Row]], max_stretches: int) -> list[Row]:
    """About `max_stretches` stretches of all parts, evenly spread, and where there is room at least
    one of each part: a trial that is left out tells nothing.
    """
    if len(parts) > max_stretches:
        parts = [[row for part in parts for row in part]]
    total = sum(map(len, parts))
    chosen = []
    for part in parts:
        count = max(1, round(min(1.0, max_stretches / total) * len(part)))
        places = np.linspace(0, len(part) - 1, count).round().astype(int)
        chosen += [part[i] for i in np.unique(places)]
    return chosen


def broken(time: np.ndarray) -> np.ndarray:
    """[T-1]: whether a gap follows a row of a trial; time [T] s."""
    steps = np.diff(time)
    return steps > max(UNBROKEN.min_gap_rows * float(np.median(steps)), UNBROKEN.min_gap)


def _first_rows(trial: TrialSpans) -> list[int]:
    """Find the rows where consecutive stretches begin, over no gap, with enough of their angles
    read.
    """
    gaps = np.flatnonzero(broken(trial.time))
    read_share = np.isfinite(trial.q).mean(1) if trial.q.shape[1] else np.ones(len(trial.time))
    begins, row = [], 0
    while row < len(trial.time) and trial.last[row] < len(trial.time):
        end = int(trial.last[row])
        inside = gaps[(gaps >= row) & (gaps < end)]
        if len(inside):
            row = int(inside[-1]) + 1
            continue
        if end > row and read_share[row : end + 1].mean() > UNBROKEN.min_read_share:
            begins.append(row)
        row = max(end, row + 1)
    return begins
