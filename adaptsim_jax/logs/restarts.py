"""A clock that starts again within a table: several trials in one file."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from adaptsim_jax.logs.table_checks import MIN_ROWS

NEAR = 2.0
"""Steps from its first value within which a clock starts again."""


def cuts(time: np.ndarray) -> list[slice]:
    """The rows between steps back of `time [T]`."""
    edges = [0, *(np.flatnonzero(np.diff(time) < 0) + 1).tolist(), len(time)]
    return [slice(a, b) for a, b in itertools.pairwise(edges)]


def restarted(time: np.ndarray) -> list[slice]:
    """The rows of each trial where `time [T]` starts again at about its first value, and increases
    between; none where it never does, or does anything else.
    """
    parts = cuts(time)
    if len(parts) < 2 or not np.all(np.isfinite(time)):
        return []
    steps = np.diff(time)
    if np.any(steps > 0):
        near = NEAR * float(np.median(steps[steps > 0]))
    else:
        near = 0.0
    whole = (
        len(time[part]) >= MIN_ROWS
        and np.all(np.diff(time[part]) > 0)
        and abs(time[part][0] - time[0]) <= near
        for part in parts
    )
    if all(whole):
        return parts
    return []


def naming(cells: Mapping[str, Sequence[str]], time: np.ndarray) -> str | None:
    """The first column of `cells [T]` that holds one word between steps back of `time [T]`, and
    another one after each; None where none does.
    """
    parts = cuts(time)
    if len(parts) < 2 or min(len(time[part]) for part in parts) < MIN_ROWS:
        return None
    for name, column in cells.items():
        if len(column) != len(time):
            continue
        words = [set(column[part]) for part in parts]
        said = {next(iter(w)).strip() for w in words if len(w) == 1}
        if len(said) == len(parts) and "" not in said:
            return name
    return None
