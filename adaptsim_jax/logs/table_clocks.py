"""Times of tables: in two parts, starting again with each trial, and of topics joined by rows."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.clock import Series, merge
from adaptsim_jax.logs.columns import NANOS, TIME, role
from adaptsim_jax.logs.criteria import TABLE

PAIRS = {
    "nsec": "sec",
    "nsecs": "secs",
    "nanosec": "sec",
    "nanosecs": "secs",
    "nanoseconds": "seconds",
}
"""How the part in nanoseconds is called -> the seconds beside it."""


def find_time_parts(names: Iterable[str]) -> tuple[str, str] | None:
    """The first columns that are called as seconds and their nanoseconds, but for that alike; None
    where there are none.
    """
    names = list(names)
    for name in names:
        start, word = re.fullmatch(r"(.*?)([A-Za-z]*)", name, re.DOTALL).groups()  # type: ignore[union-attr]
        seconds_name = f"{start}{PAIRS.get(word.lower(), '')}".lower()
        if word.lower() in PAIRS:
            seconds = next((n for n in names if n.lower() == seconds_name), None)
        else:
            seconds = None
        if seconds is not None:
            return seconds, name
    return None


def join_time_parts(seconds: np.ndarray, nanos: np.ndarray) -> np.ndarray:
    """The time `[T]` in s."""
    return seconds + 1e-9 * nanos


def join_time(
    path: str | Path, columns: Mapping[str, np.ndarray], ours: Mapping[str, str]
) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """`columns [T]` with one time where there are two parts of it, and a note on that.

    BadInput where what is given for nanoseconds is no part of a second.

    Args:
        ours: What a column is to us.
    """
    clock = next((name for name in columns if ours.get(name, name) in TIME), None)
    nanos = next((name for name in columns if ours.get(name, name) == NANOS), None)
    if clock is None or nanos is None:
        return dict(columns), ()
    if np.any((columns[nanos] < 0) | (columns[nanos] >= 1e9)):
        raise BadInput(
            f"{path}: column {nanos} goes beyond a second, up to {np.nanmax(columns[nanos]):.4g} "
            f"ns; give [columns] {NANOS} the "
            'nanoseconds beside whole seconds, or write time = "ns" under [units] where one column '
            "has it all"
        )
    out = {name: values for name, values in columns.items() if name != nanos}
    return out | {clock: join_time_parts(columns[clock], columns[nanos])}, (
        f"time taken from {clock} and {nanos} together",
    )


def time_parts_line(seconds: str, nanos: str) -> str:
    """The line of meta.toml that names both parts."""
    return f'[columns] time = ["{seconds}", "{nanos}"]'


def cut_at_steps_back(time: np.ndarray) -> list[slice]:
    """The rows between steps back of `time [T]`."""
    edges = [0, *(np.flatnonzero(np.diff(time) < 0) + 1).tolist(), len(time)]
    return [slice(a, b) for a, b in itertools.pairwise(edges)]


def cut_at_restarts(time: np.ndarray) -> list[slice]:
    """The rows of each trial where `time [T]` starts again at about its first value, and increases
    between. None where it never does, or does anything else.
    """
    parts = cut_at_steps_back(time)
    if len(parts) < 2 or not np.all(np.isfinite(time)):
        return []
    steps = np.diff(time)
    if np.any(steps > 0):
        max_offset = TABLE.restart_steps * float(np.median(steps[steps > 0]))
    else:
        max_offset = 0.0
    clocks = [time[part] for part in parts]
    are_whole = (
        len(clock) >= TABLE.min_rows
        and np.all(np.diff(clock) > 0)
        and abs(clock[0] - time[0]) <= max_offset
        for clock in clocks
    )
    if all(are_whole):
        return parts
    return []


def cut_at_headers(lines: np.ndarray, again: Sequence[int]) -> list[slice]:
    """The rows, on `lines [T]`, of each part that has a header of its own, but for parts of too few
    rows. None where the header stands once.
    """
    edges = [0, *np.searchsorted(lines, again).tolist(), len(lines)]
    parts = [slice(a, b) for a, b in itertools.pairwise(edges) if b - a >= TABLE.min_rows]
    return parts if again else []


def trial_column(cells: Mapping[str, Sequence[str]], time: np.ndarray) -> str | None:
    """The first column of `cells [T]` that holds one word between steps back of `time [T]`, and
    another one after each; None where none does.
    """
    parts = cut_at_steps_back(time)
    if len(parts) < 2 or min(len(time[part]) for part in parts) < TABLE.min_rows:
        return None
    for name, column in cells.items():
        if len(column) != len(time):
            continue
        words = [set(column[part]) for part in parts]
        labels = {next(iter(w)).strip() for w in words if len(w) == 1}
        if len(labels) == len(parts) and "" not in labels:
            return name
    return None


COMMANDS = ("target", "ctrl", "tau_commanded", "u", "i")
LINE = "q_line of the file"


def split_clock(
    path: str | Path, columns: Mapping[str, np.ndarray], lines: np.ndarray, ours: Mapping[str, str]
) -> tuple[dict[str, np.ndarray], np.ndarray, tuple[str, ...]] | None:
    """`columns [T]` (NaN where a cell is missing) with their lines on the clock of the states, and
    what was done; None where rows are whole, or hold too little.

    Args:
        ours: What a column is to us where the file names it otherwise.
    """
    roles = {
        name: column_role
        for name in columns
        if (column_role := role(ours.get(name, name))) is not None
    }
    clock = next((name for name in columns if ours.get(name, name) in TIME), None)
    names = [
        name for name, column_role in roles.items() if column_role.stem not in ("time", "trial")
    ]
    if clock is None or len(lines) < 2 or not names or not np.all(np.isfinite(columns[clock])):
        return None
    is_there = {name: np.isfinite(columns[name]) for name in names}
    is_complete = np.all(list(is_there.values()), axis=0)
    states = [name for name in names if roles[name].stem not in COMMANDS]
    angles = [name for name in names if roles[name].stem == "q"]
    if (
        np.mean(~is_complete) < TABLE.min_incomplete_share
        or not angles
        or any(is_there[n].mean() < TABLE.min_column_share for n in states)
    ):
        return None
    if np.any(np.diff(columns[clock]) < 0):
        return None
    topics: dict[tuple[bytes, bool], list[str]] = {}
    for name in names:
        topics.setdefault((is_there[name].tobytes(), name in states), []).append(name)
    key_of = {name: f"{roles[name].stem}_{k}" for k, name in enumerate(names)}
    series_by_kind: dict[bool, list[Series]] = {True: [], False: []}
    for (_, is_state), topic_columns in topics.items():
        rows = is_there[topic_columns[0]]
        values = {key_of[name]: columns[name][rows] for name in topic_columns}
        series_by_kind[is_state].append(
            Series(
                columns[clock][rows],
                values | ({LINE: lines[rows].astype(float)} if is_state else {}),
            )
        )
    main = max(series_by_kind[True], key=lambda series: len(series.time))
    series_by_kind[True] = [
        s if s is main else s.of([n for n in s.columns if n != LINE]) for s in series_by_kind[True]
    ]
    out, notes = merge(str(path), series_by_kind[True], series_by_kind[False])
    columns_by_name = {name: out[key_of[name]] for name in names}
    commands = [name for name in names if name not in states]
    held_text = f", {', '.join(commands)} held from when they came" if commands else ""
    notes = (
        "rows hold parts of a sample, as topics in one file do: taken at the times of "
        f"{', '.join(angles)}{held_text}",
        *notes,
    )
    return {clock: out["time"]} | columns_by_name, np.round(out[LINE]).astype(np.int64), notes
