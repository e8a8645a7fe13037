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


def pair(names: Iterable[str]) -> tuple[str, str] | None:
    """The first columns that are called as seconds and their nanoseconds, but for that alike; None
    where there are none.
    """
    names = list(names)
    for name in names:
        start, word = re.fullmatch(r"(.*?)([A-Za-z]*)", name, re.DOTALL).groups()  # type: ignore[union-attr]
        whole = f"{start}{PAIRS.get(word.lower(), '')}".lower()
        if word.lower() in PAIRS:
            seconds = next((n for n in names if n.lower() == whole), None)
        else:
            seconds = None
        if seconds is not None:
            return seconds, name
    return None


def together(seconds: np.ndarray, nanos: np.ndarray) -> np.ndarray:
    """The time `[T]` in s."""
    return seconds + 1e-9 * nanos


def joined_time(
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
    return out | {clock: together(columns[clock], columns[nanos])}, (
        f"time taken from {clock} and {nanos} together",
    )


def both(seconds: str, nanos: str) -> str:
    """The line of meta.toml that names both parts."""
    return f'[columns] time = ["{seconds}", "{nanos}"]'


def cuts(time: np.ndarray) -> list[slice]:
    """The rows between steps back of `time [T]`."""
    edges = [0, *(np.flatnonzero(np.diff(time) < 0) + 1).tolist(), len(time)]
    return [slice(a, b) for a, b in itertools.pairwise(edges)]


def restarted(time: np.ndarray) -> list[slice]:
    """The rows of each trial where `time [T]` starts again at about its first value, and increases
    between. None where it never does, or does anything else.
    """
    parts = cuts(time)
    if len(parts) < 2 or not np.all(np.isfinite(time)):
        return []
    steps = np.diff(time)
    if np.any(steps > 0):
        near = TABLE.restart * float(np.median(steps[steps > 0]))
    else:
        near = 0.0
    clocks = [time[part] for part in parts]
    whole = (
        len(clock) >= TABLE.min_rows
        and np.all(np.diff(clock) > 0)
        and abs(clock[0] - time[0]) <= near
        for clock in clocks
    )
    if all(whole):
        return parts
    return []


def headed_again(lines: np.ndarray, again: Sequence[int]) -> list[slice]:
    """The rows, on `lines [T]`, of each part that has a header of its own, but for parts of too few
    rows. None where the header stands once.
    """
    edges = [0, *np.searchsorted(lines, again).tolist(), len(lines)]
    parts = [slice(a, b) for a, b in itertools.pairwise(edges) if b - a >= TABLE.min_rows]
    return parts if again else []


def naming(cells: Mapping[str, Sequence[str]], time: np.ndarray) -> str | None:
    """The first column of `cells [T]` that holds one word between steps back of `time [T]`, and
    another one after each; None where none does.
    """
    parts = cuts(time)
    if len(parts) < 2 or min(len(time[part]) for part in parts) < TABLE.min_rows:
        return None
    for name, column in cells.items():
        if len(column) != len(time):
            continue
        words = [set(column[part]) for part in parts]
        stated = {next(iter(w)).strip() for w in words if len(w) == 1}
        if len(stated) == len(parts) and "" not in stated:
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
    roles = {name: found for name in columns if (found := role(ours.get(name, name))) is not None}
    clock = next((name for name in columns if ours.get(name, name) in TIME), None)
    names = [name for name, found in roles.items() if found.stem not in ("time", "trial")]
    if clock is None or len(lines) < 2 or not names or not np.all(np.isfinite(columns[clock])):
        return None
    there = {name: np.isfinite(columns[name]) for name in names}
    whole = np.all(list(there.values()), axis=0)
    states = [name for name in names if roles[name].stem not in COMMANDS]
    angles = [name for name in names if roles[name].stem == "q"]
    if (
        np.mean(~whole) < TABLE.joined
        or not angles
        or any(there[n].mean() < TABLE.seldom for n in states)
    ):
        return None
    if np.any(np.diff(columns[clock]) < 0):
        return None
    topics: dict[tuple[bytes, bool], list[str]] = {}
    for name in names:
        topics.setdefault((there[name].tobytes(), name in states), []).append(name)
    called = {name: f"{roles[name].stem}_{k}" for k, name in enumerate(names)}
    made: dict[bool, list[Series]] = {True: [], False: []}
    for (_, is_state), own in topics.items():
        here = there[own[0]]
        values = {called[name]: columns[name][here] for name in own}
        made[is_state].append(
            Series(
                columns[clock][here],
                values | ({LINE: lines[here].astype(float)} if is_state else {}),
            )
        )
    main = max(made[True], key=lambda series: len(series.time))
    made[True] = [s if s is main else s.of([n for n in s.columns if n != LINE]) for s in made[True]]
    out, notes = merge(str(path), made[True], made[False])
    selected = {name: out[called[name]] for name in names}
    held = [name for name in names if name not in states]
    acts = f", {', '.join(held)} held from when they came" if held else ""
    notes = (
        "rows hold parts of a sample, as topics in one file do: taken at the times of "
        f"{', '.join(angles)}{acts}",
        *notes,
    )
    return {clock: out["time"]} | selected, np.round(out[LINE]).astype(np.int64), notes
