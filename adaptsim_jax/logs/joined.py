"""Tables whose rows hold parts of a sample: exports of several topics in one file, or commands that
come less often than states.

Each set of columns that are there in the same rows is a topic of its own; states give the clock,
and what is commanded holds from when it came (`clock.merge`).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from adaptsim_jax.logs.clock import Series, merge
from adaptsim_jax.logs.columns import TIME, role

JOINED = 0.3
"""Share of rows that lack something from which on a table counts as joined of topics."""
SELDOM = 0.05
"""Share of rows that states must have at least."""
COMMANDS = ("target", "ctrl", "tau_commanded", "u", "i")
LINE = "q_line of the file"


def apart(
    path: str | Path, columns: Mapping[str, np.ndarray], lines: np.ndarray, ours: Mapping[str, str]
) -> tuple[dict[str, np.ndarray], np.ndarray, tuple[str, ...]] | None:
    """`columns [T]` (NaN where a cell is missing) with their lines on the clock of the states, and
    what was done; None where rows are whole, or hold too little. ours: what a column is to us where
    the file names it otherwise.
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
    if np.mean(~whole) < JOINED or not angles or any(there[n].mean() < SELDOM for n in states):
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
    kept = {name: out[called[name]] for name in names}
    held = [name for name in names if name not in states]
    acts = f", {', '.join(held)} held from when they came" if held else ""
    notes = (
        f"rows hold parts of a sample, as topics in one file do: taken at the times of "
        f"{', '.join(angles)}{acts}",
        *notes,
    )
    return {clock: out["time"]} | kept, np.round(out[LINE]).astype(np.int64), notes
