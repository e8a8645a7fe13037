"""Series of messages with stamps of their own brought onto one clock."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.criteria import CLOCK, TABLE


@dataclass(frozen=True)
class Stamped:
    """`time [K]` ns of messages, `selected [K]`: those that have one.

    - `stamped`: Whether times are their own.
    - `late`: How long they are on their way (median, ns).
    - `unstamped`, `distant`: How many lack a stamp, or have one far from the others'.
    """

    time: np.ndarray
    selected: np.ndarray
    stamped: bool
    late: int
    unstamped: int = 0
    distant: int = 0

    def notes(self, topic: str) -> tuple[str, ...]:
        """What a person should know of it."""
        if not self.stamped:
            return (f"topic {topic} has no stamps: the bag's time of arrival is taken",)
        left = "left out, the others keep theirs"
        if self.unstamped:
            out = [f"topic {topic}: {self.unstamped} messages without a stamp {left}"]
        else:
            out = []
        return (
            *out,
            *(
                [f"topic {topic}: {self.distant} stamps far from the others' {left}"]
                if self.distant
                else []
            ),
        )


def stamped(arrived: np.ndarray, stamps: np.ndarray, group: np.ndarray | None = None) -> Stamped:
    """Times of messages that arrived at `arrived [K]` ns with stamps `[K]` (0: none).

    Args:
        group [K]: Who sends. A sender of whom no message has a stamp counts by arrival, less the
            delay of the others.
    """
    has = stamps > 0
    distant = has & _distant(arrived, stamps, has)
    good = has & ~distant
    if (
        not good.any()
        or good.sum() <= len(stamps) / 2
        or len(set(stamps[good].tolist())) <= good.sum() / 2
    ):
        return Stamped(arrived, np.ones(len(arrived), bool), False, 0)
    late = int(np.median((arrived - stamps)[good]))
    time = np.where(good, stamps, arrived - late)
    selected = good.copy()
    for one in set(group.tolist()) if group is not None else ():
        here = group == one
        if not good[here].any():
            selected |= here
    return Stamped(
        time, selected, True, late, int(np.sum(~has & ~selected)), int(np.sum(distant & ~selected))
    )


def _distant(arrived: np.ndarray, stamps: np.ndarray, has: np.ndarray) -> np.ndarray:
    """Which stamps are far off: those whose distance from their arrival is not that of the stamps
    around them. A simulated clock may run at another pace, so that the neighbours alone judge, by
    so much more as they are apart.
    """
    at = np.flatnonzero(has)
    out = np.zeros(len(stamps), bool)
    if len(at) < CLOCK.min_stamps:
        return out
    off, when = (arrived - stamps)[at], arrived[at]
    width = min(2 * CLOCK.window + 1, len(at))
    first = np.clip(np.arange(len(at)) - width // 2, 0, len(at) - width)
    around = first[:, None] + np.arange(width)
    separate = np.abs(when - np.median(when[around], axis=1))
    out[at] = np.abs(off - np.median(off[around], axis=1)) > CLOCK.max_offset + separate
    return out


HELD = ("tau", "target", "ctrl", "u", "i")
"""Stems of columns that hold from their row to the next; others are interpolated."""


@dataclass(frozen=True)
class Series:
    """`time [K]` s in the order of arrival, `columns`: name -> `[K]`.

    - `reordered`: Its names changed their order.
    - `straight`: Of commands, whether they are moved to from row to row, not held.
    """

    time: np.ndarray
    columns: dict[str, np.ndarray]
    reordered: bool = False
    straight: bool = False

    def of(self, names: Collection[str]) -> Series:
        """With these columns alone."""
        return replace(
            self, columns={name: values for name, values in self.columns.items() if name in names}
        )


def merge(
    path: str, states: list[Series], commands: list[Series]
) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """Columns on one clock with `time` from 0 s, and what was done to get there.

    The clock is that of the state series with most rows, over the time that all state series share.
    Other states are interpolated between their rows. A command, or an effort, acts from its own
    time to the next one's: a row has the mean of what acts until the next row, so that nothing is
    taken to wait for a row. Before the first command rows are cut off. A joint's gap of more than
    10 of its intervals is NaN; one that speaks fewer than `rare` times stays where it was last.
    """
    notes: list[str] = []
    states = [_sorted(path, series, notes) for series in states]
    commands = [_sorted(path, series, notes) for series in commands]
    if any(series.reordered for series in (*states, *commands)):
        notes.append("the order of joint names changes between messages: sorted by name")
    main = max(states, key=lambda series: len(series.time))
    # what names no joint beside those of the main series: its rows lack joints that the others have
    states = [
        series
        for series in states
        if series is main or not set(series.columns) <= set(main.columns)
    ]
    rare = [series for series in states if len(series.time) < CLOCK.rare and series is not main]
    for series in rare:
        joints = sorted({name.partition("_")[2] for name in series.columns})
        notes.append(
            f"{', '.join(joints)}: {len(series.time)} messages in all, taken to stay as they say"
        )
    often = [series for series in states if not any(series is other for other in rare)]
    rows = _shared_rows(path, main, often, commands)
    clock = main.time[rows]
    out = {"time": clock - clock[0]}
    for series in states:
        seldom = any(series is other for other in rare)
        own = series.of([name for name in series.columns if name not in out])
        out |= _at_rows(series, rows) if series is main else _states_on(clock, own, seldom)
    for name in [n for series in rare for n in series.columns if n.startswith("q_")]:
        if any(n.startswith("v_") for n in out):
            out.setdefault(f"v{name[1:]}", np.zeros(len(clock)))
    for series in commands:
        for name, values in series.columns.items():
            if name not in out:
                out[name] = _acting(clock, series.time, values, series.straight)
    if len(states) > 1:
        notes.append(
            f"{len(states)} publishers of joint states brought onto the clock of the one with most "
            "messages"
        )
    cut = len(main.time) - len(clock)
    if cut:
        notes.append(f"{cut} rows cut off where not all joints and commands are there")
    return out, tuple(dict.fromkeys(notes))


def _shared_rows(
    path: str, main: Series, states: list[Series], commands: list[Series]
) -> np.ndarray:
    """Rows `[K]` of the main series in the time that all share; BadInput for too few of them."""
    start = max(series.time[0] for series in (*states, *commands))
    stop = min(series.time[-1] for series in states)
    rows = (main.time >= start) & (main.time <= stop)
    if (count := int(rows.sum())) < TABLE.min_rows:
        raise BadInput(
            f"{path}: its topics share {count} rows; a trial needs at least {TABLE.min_rows}, "
            "record joints and commands together"
        )
    return rows


def _at_rows(series: Series, rows: np.ndarray) -> dict[str, np.ndarray]:
    return {name: values[rows] for name, values in series.columns.items()}


def _states_on(clock: np.ndarray, series: Series, seldom: bool) -> dict[str, np.ndarray]:
    """Columns of another series at the rows of `clock [T]`.

    Args:
        seldom: They stay where they were.
    """
    return {
        name: _acting(clock, series.time, values, False)
        if name.split("_")[0] in HELD and not seldom
        else _onto(clock, series.time, values, hold=seldom)
        for name, values in series.columns.items()
    }


def _sorted(path: str, series: Series, notes: list[str]) -> Series:
    """By time, of rows with the same time the first. BadInput where the clock was set back on the
    way.
    """
    _check_set_back(path, series.time)
    order = np.argsort(series.time, kind="stable")
    if np.any(np.diff(series.time) < 0):
        notes.append("messages out of order: sorted by their stamps")
    time = series.time[order]
    keep = np.concatenate([[True], np.diff(time) > 0])
    if not keep.all():
        notes.append(f"{int((~keep).sum())} messages repeat a stamp: left out")
    columns = {name: values[order][keep] for name, values in series.columns.items()}
    return replace(series, time=time[keep], columns=columns)


def _check_set_back(path: str, time: np.ndarray) -> None:
    """BadInput where `time [K]` s steps back over a stretch that it had passed already: rows lie
    twice as dense there, two parts of the motion over each other. Messages that are only out of
    order leave no such stretch.
    """
    steps = np.diff(time)
    usual = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 0.0
    for k in np.flatnonzero(steps < -CLOCK.set_back * usual):
        high, back = time[k], time[k] - time[k + 1]
        low = max(time[k + 1], time[: k + 1].min())  # what was passed before and is passed again
        there = int(np.sum((time >= low) & (time <= high)))
        if there > CLOCK.min_overlap and there > CLOCK.dense * ((high - low) / usual + 1.0):
            raise BadInput(
                f"{path}: message {k + 2}: the clock was set back by {back:.4g} s; cut the bag "
                "there, and take the parts for two trials"
            )


def _acting(clock: np.ndarray, time: np.ndarray, values: np.ndarray, straight: bool) -> np.ndarray:
    """Mean `[T]` of a command `values [K]` at `time [K]` from each row of `clock [T]` to the next,
    held or straight between its rows; NaN where it never says anything.
    """
    here = np.isfinite(values)
    time, values = time[here], values[here]
    if not len(time):
        return np.full(len(clock), np.nan)
    edges = np.append(clock, clock[-1] + (np.median(np.diff(clock)) if len(clock) > 1 else 0.0))
    row = np.maximum(np.searchsorted(time, edges, side="right") - 1, 0)
    held = values[row]
    span = np.diff(edges)
    # where nothing new comes within a row the command itself, to the bit
    still = (
        np.searchsorted(time, edges[1:], side="left") - 1
        == np.searchsorted(time, edges[:-1], side="right") - 1
    )
    if straight:
        at = np.interp(edges, time, values)
        steps = np.diff(time) * 0.5 * (values[1:] + values[:-1])
        part = (edges - time[row]) * 0.5 * (at + held)
    else:
        steps = np.diff(time) * values[:-1]
        part = (edges - time[row]) * held
    area = np.concatenate([[0.0], np.cumsum(steps)])[row] + part
    mean = np.where(span > 0, np.diff(area) / np.where(span > 0, span, 1.0), held[:-1])
    if straight:
        return mean
    return np.where(still, held[:-1], mean)


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
        wide = np.concatenate([[False], np.diff(time) > CLOCK.gap * np.median(np.diff(time))])
        out[wide[after] & (clock != time[after])] = np.nan
    return out
