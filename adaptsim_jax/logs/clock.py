"""Series of messages with stamps of their own brought onto one clock."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.criteria import CLOCK, TABLE


@dataclass(frozen=True)
class MessageTimes:
    """`time [K]` ns of messages; `has_time [K]`: whether it is valid.

    - `has_stamps`: Whether times are the messages' own.
    - `delay`: From stamp to arrival, the median, ns.
    - `n_unstamped`, `n_outlying`: How many lack a stamp, or have one far from the others'.
    """

    time: np.ndarray
    has_time: np.ndarray
    has_stamps: bool
    delay: int
    n_unstamped: int = 0
    n_outlying: int = 0

    def notes(self, topic: str) -> tuple[str, ...]:
        """What a person should know of it."""
        if not self.has_stamps:
            return (f"topic {topic} has no stamps: the bag's time of arrival is taken",)
        left = "left out, the others keep theirs"
        if self.n_unstamped:
            out = [f"topic {topic}: {self.n_unstamped} messages without a stamp {left}"]
        else:
            out = []
        return (
            *out,
            *(
                [f"topic {topic}: {self.n_outlying} stamps far from the others' {left}"]
                if self.n_outlying
                else []
            ),
        )


def message_times(
    arrived: np.ndarray, stamps: np.ndarray, group: np.ndarray | None = None
) -> MessageTimes:
    """Decide the times of messages that arrived at `arrived [K]` ns with stamps `[K]` (0: none).

    Args:
        group [K]: Who sends. A sender of whom no message has a stamp counts by arrival, less the
            delay of the others.
    """
    has_stamp = stamps > 0
    n_outlying = has_stamp & _outlying_stamps(arrived, stamps, has_stamp)
    is_good = has_stamp & ~n_outlying
    if (
        not is_good.any()
        or is_good.sum() <= len(stamps) / 2
        or len(set(stamps[is_good].tolist())) <= is_good.sum() / 2
    ):
        return MessageTimes(arrived, np.ones(len(arrived), bool), False, 0)
    delay = int(np.median((arrived - stamps)[is_good]))
    time = np.where(is_good, stamps, arrived - delay)
    has_time = is_good.copy()
    for sender in set(group.tolist()) if group is not None else ():
        is_sender = group == sender
        if not is_good[is_sender].any():
            has_time |= is_sender
    return MessageTimes(
        time,
        has_time,
        True,
        delay,
        int(np.sum(~has_stamp & ~has_time)),
        int(np.sum(n_outlying & ~has_time)),
    )


def _outlying_stamps(arrived: np.ndarray, stamps: np.ndarray, has_stamp: np.ndarray) -> np.ndarray:
    """Find stamps [K] whose delay is not that of the stamps around them. A simulated clock may run
    at another pace, so that neighbours alone judge, and the limit grows by their distance in time.
    """
    stamped = np.flatnonzero(has_stamp)
    is_outlying = np.zeros(len(stamps), bool)
    if len(stamped) < CLOCK.min_stamps:
        return is_outlying
    delay, arrival = (arrived - stamps)[stamped], arrived[stamped]
    width = min(2 * CLOCK.n_neighbours + 1, len(stamped))
    first = np.clip(np.arange(len(stamped)) - width // 2, 0, len(stamped) - width)
    neighbours = first[:, None] + np.arange(width)
    time_distance = np.abs(arrival - np.median(arrival[neighbours], axis=1))
    is_outlying[stamped] = (
        np.abs(delay - np.median(delay[neighbours], axis=1)) > CLOCK.max_offset + time_distance
    )
    return is_outlying


HELD_STEMS = ("tau", "target", "ctrl", "u", "i")
"""Stems of columns that hold from their row to the next; others are interpolated."""


@dataclass(frozen=True)
class Series:
    """`time [K]` s in the order of arrival, `columns`: name -> `[K]`.

    - `is_reordered`: Its names changed their order.
    - `is_linear`: Of commands, whether they are moved to from row to row, not held.
    """

    time: np.ndarray
    columns: dict[str, np.ndarray]
    is_reordered: bool = False
    is_linear: bool = False

    def of(self, names: Collection[str]) -> Series:
        """Return the series with these columns alone."""
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
    10 of its intervals is NaN; one that speaks fewer than `sparse` times stays where it was last.
    """
    notes: list[str] = []
    states = [_sort(path, series, notes) for series in states]
    commands = [_sort(path, series, notes) for series in commands]
    if any(series.is_reordered for series in (*states, *commands)):
        notes.append("the order of joint names changes between messages: sorted by name")
    main = max(states, key=lambda series: len(series.time))
    # what names no joint beside those of the main series: its rows lack joints that the others have
    states = [
        series
        for series in states
        if series is main or not set(series.columns) <= set(main.columns)
    ]
    sparse = [
        series for series in states if len(series.time) < CLOCK.min_messages and series is not main
    ]
    for series in sparse:
        joints = sorted({name.partition("_")[2] for name in series.columns})
        notes.append(
            f"{', '.join(joints)}: {len(series.time)} messages in all, taken to stay as they say"
        )
    dense = [series for series in states if not any(series is other for other in sparse)]
    rows = _shared_rows(path, main, dense, commands)
    clock = main.time[rows]
    columns = {"time": clock - clock[0]}
    for series in states:
        is_sparse = any(series is other for other in sparse)
        own_columns = series.of([name for name in series.columns if name not in columns])
        columns |= (
            _at_rows(series, rows) if series is main else _states_on(clock, own_columns, is_sparse)
        )
    for name in [n for series in sparse for n in series.columns if n.startswith("q_")]:
        if any(n.startswith("v_") for n in columns):
            columns.setdefault(f"v{name[1:]}", np.zeros(len(clock)))
    for series in commands:
        for name, values in series.columns.items():
            if name not in columns:
                columns[name] = _mean_between_rows(clock, series.time, values, series.is_linear)
    if len(states) > 1:
        notes.append(
            f"{len(states)} publishers of joint states brought onto the clock of the one with most "
            "messages"
        )
    n_cut = len(main.time) - len(clock)
    if n_cut:
        notes.append(f"{n_cut} rows cut off where not all joints and commands are there")
    return columns, tuple(dict.fromkeys(notes))


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


def _states_on(clock: np.ndarray, series: Series, is_sparse: bool) -> dict[str, np.ndarray]:
    """Columns of another series at the rows of `clock [T]`.

    Args:
        is_sparse: They stay where they were.
    """
    return {
        name: _mean_between_rows(clock, series.time, values, False)
        if name.split("_")[0] in HELD_STEMS and not is_sparse
        else _interpolate(clock, series.time, values, hold=is_sparse)
        for name, values in series.columns.items()
    }


def _sort(path: str, series: Series, notes: list[str]) -> Series:
    """Sort rows by time; of rows with the same time the first stays. BadInput where the clock was
    set back.
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
    usual_step = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 0.0
    for k in np.flatnonzero(steps < -CLOCK.min_set_back * usual_step):
        end, set_back = time[k], time[k] - time[k + 1]
        start = max(time[k + 1], time[: k + 1].min())  # what was passed before and is passed again
        n_there = int(np.sum((time >= start) & (time <= end)))
        if n_there > CLOCK.min_overlap and n_there > CLOCK.min_density * (
            (end - start) / usual_step + 1.0
        ):
            raise BadInput(
                f"{path}: message {k + 2}: the clock was set back by {set_back:.4g} s; cut the bag "
                "there, and take the parts for two trials"
            )


def _mean_between_rows(
    clock: np.ndarray, time: np.ndarray, values: np.ndarray, is_linear: bool
) -> np.ndarray:
    """Average `[T]` a command `values [K]` at `time [K]` from each row of `clock [T]` to the next,
    held or straight between its rows; NaN where it never says anything.
    """
    is_finite = np.isfinite(values)
    time, values = time[is_finite], values[is_finite]
    if not len(time):
        return np.full(len(clock), np.nan)
    edges = np.append(clock, clock[-1] + (np.median(np.diff(clock)) if len(clock) > 1 else 0.0))
    row = np.maximum(np.searchsorted(time, edges, side="right") - 1, 0)
    held = values[row]
    span = np.diff(edges)
    # where nothing new comes within a row the command itself, to the bit
    is_unchanged = (
        np.searchsorted(time, edges[1:], side="left") - 1
        == np.searchsorted(time, edges[:-1], side="right") - 1
    )
    if is_linear:
        at = np.interp(edges, time, values)
        steps = np.diff(time) * 0.5 * (values[1:] + values[:-1])
        partial_area = (edges - time[row]) * 0.5 * (at + held)
    else:
        steps = np.diff(time) * values[:-1]
        partial_area = (edges - time[row]) * held
    area = np.concatenate([[0.0], np.cumsum(steps)])[row] + partial_area
    mean = np.where(span > 0, np.diff(area) / np.where(span > 0, span, 1.0), held[:-1])
    if is_linear:
        return mean
    return np.where(is_unchanged, held[:-1], mean)


def _interpolate(
    clock: np.ndarray, time: np.ndarray, values: np.ndarray, *, hold: bool
) -> np.ndarray:
    is_finite = np.isfinite(values)
    time, values = time[is_finite], values[is_finite]
    if not len(time):
        return np.full(len(clock), np.nan)
    if hold:
        return values[np.maximum(np.searchsorted(time, clock, side="right") - 1, 0)]
    out = np.interp(clock, time, values)
    if len(time) > 1:
        next_row = np.minimum(np.searchsorted(time, clock), len(time) - 1)
        is_gap = np.concatenate(
            [[False], np.diff(time) > CLOCK.max_gap_rows * np.median(np.diff(time))]
        )
        out[is_gap[next_row] & (clock != time[next_row])] = np.nan
    return out
