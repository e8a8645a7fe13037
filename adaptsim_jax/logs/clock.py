"""Series that were logged at times of their own, brought onto one clock."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.tables import MIN_ROWS

HELD = ("tau", "target", "ctrl", "u", "i")
"""Stems of columns that hold from their row to the next; others are interpolated."""
LATE = 10
"""Rows of its own, as a multiple of their median spacing, after which a series has a gap."""


DENSE = 1.5
"""Rows in a stretch of time, as a multiple of what the usual spacing leaves, from which on two stretches lie over each other."""


@dataclass(frozen=True)
class Series:
    """`time [K]` s in the order of arrival, `columns`: name -> `[K]`; `reordered`: its names changed their order."""

    time: np.ndarray
    columns: dict[str, np.ndarray]
    reordered: bool = False


def merge(path: str, states: list[Series], commands: list[Series]) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """Columns on one clock with `time` from 0 s, and what was done to get there.

    The clock is that of the state series with most rows, over the time that all state series share. Other states are
    interpolated between their rows (efforts held), commands hold from their time to the next; before the first
    command rows are cut off. A joint's gap of more than 10 of its intervals is NaN.
    """
    notes: list[str] = []
    states = [_sorted(path, series, notes) for series in states]
    commands = [_sorted(path, series, notes) for series in commands]
    if any(series.reordered for series in (*states, *commands)):
        notes.append("the order of joint names changes between messages: sorted by name")
    main = max(states, key=lambda series: len(series.time))
    # what names no joint beside those of the main series: its rows lack joints that the others have
    states = [series for series in states if series is main or not set(series.columns) <= set(main.columns)]
    start = max(series.time[0] for series in (*states, *commands))
    stop = min(series.time[-1] for series in states)
    rows = (main.time >= start) & (main.time <= stop)
    clock = main.time[rows]
    if len(clock) < MIN_ROWS:
        raise BadInput(
            f"{path}: its topics share {len(clock)} rows; a trial needs at least {MIN_ROWS}, record joints and commands together"
        )
    out = {"time": clock - clock[0]}
    for series in states:
        for name, values in series.columns.items():
            if series is main:
                out[name] = values[rows]
            elif name in out:
                continue
            else:
                out[name] = _onto(clock, series.time, values, hold=name.split("_")[0] in HELD)
    for series in commands:
        out |= {
            name: _onto(clock, series.time, values, hold=True)
            for name, values in series.columns.items()
            if name not in out
        }
    if len(states) > 1:
        notes.append(f"{len(states)} publishers of joint states brought onto the clock of the one with most messages")
    cut = len(main.time) - len(clock)
    if cut:
        notes.append(f"{cut} rows cut off where not all joints and commands are there")
    return out, tuple(dict.fromkeys(notes))


def _sorted(path: str, series: Series, notes: list[str]) -> Series:
    """By time, of rows with the same time the first. BadInput where the clock was set back on the way."""
    _check_set_back(path, series.time)
    order = np.argsort(series.time, kind="stable")
    if np.any(np.diff(series.time) < 0):
        notes.append("messages out of order: sorted by their stamps")
    time = series.time[order]
    keep = np.concatenate([[True], np.diff(time) > 0])
    if not keep.all():
        notes.append(f"{int((~keep).sum())} messages repeat a stamp: left out")
    columns = {name: values[order][keep] for name, values in series.columns.items()}
    return Series(time[keep], columns, series.reordered)


def _check_set_back(path: str, time: np.ndarray) -> None:
    """BadInput where `time [K]` s steps back over a stretch that it had passed already: rows lie twice as dense there, two
    parts of the motion over each other. Messages that are only out of order leave no such stretch."""
    steps = np.diff(time)
    usual = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 0.0
    for k in np.flatnonzero(steps < -2.0 * usual):
        high, back = time[k], time[k] - time[k + 1]
        low = max(time[k + 1], time[: k + 1].min())  # what was passed before and is passed again
        there = int(np.sum((time >= low) & (time <= high)))
        if there > 4 and there > DENSE * ((high - low) / usual + 1.0):
            raise BadInput(
                f"{path}: message {k + 2}: the clock was set back by {back:.4g} s; cut the bag there, and take the parts for "
                "two trials"
            )


def _onto(clock: np.ndarray, time: np.ndarray, values: np.ndarray, *, hold: bool) -> np.ndarray:
    here = np.isfinite(values)
    time, values = time[here], values[here]
    if not len(time):
        return np.full(len(clock), np.nan)
    if hold:
        return values[np.maximum(np.searchsorted(time, clock, side="right") - 1, 0)]
    out = np.interp(clock, time, values)
    if len(time) > 1:
        after = np.minimum(np.searchsorted(time, clock), len(time) - 1)
        wide = np.concatenate([[False], np.diff(time) > LATE * np.median(np.diff(time))])
        out[wide[after] & (clock != time[after])] = np.nan
    return out
