"""A time that stands in two columns, whole seconds and nanoseconds, as ROS writes its stamps."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.columns import NANOS, TIME

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
    """`columns [T]` with one time where there are two parts of it, and a note on that. ours: what a
    column is to us.

    BadInput where what is given for nanoseconds is no part of a second.
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
