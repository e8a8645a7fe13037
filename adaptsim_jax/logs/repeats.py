"""Readings of a bus that is slower than what publishes them: each stands in several rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from adaptsim_jax.logs.clock import Series, merge
from adaptsim_jax.logs.columns import roles_of
from adaptsim_jax.logs.criteria import REPEAT
from adaptsim_jax.logs.table_clocks import LINE
from adaptsim_jax.logs.tables import RawTrial

STATES = ("q", "v", "base", "channel")


def read_once(trial: RawTrial) -> RawTrial:
    """The trial with each reading once, at the row in which it came; what acts, acts until the next
    one by its mean. Joints that are read in turn come onto one clock. As it is where readings do
    not stand in about as many rows each.
    """
    roles = roles_of(trial.columns)
    clock = next((name for name, found in roles.items() if found.stem == "time"), None)
    angles = {found.joint: name for name, found in roles.items() if found.stem == "q"}
    if clock is None or not angles:
        return trial
    for groups in ([list(angles)], [[joint] for joint in angles]):
        first = [
            _first_rows(np.stack([trial.columns[angles[joint]] for joint in group], 1))
            for group in groups
        ]
        if all(count for _, count in first):
            break
    else:
        return trial
    time, states = trial.columns[clock], []
    whose = {joint: k for k, group in enumerate(groups) for joint in group}
    for k, (rows, _) in enumerate(first):
        own = {} if states else {LINE: trial.lines[rows].astype(float)}
        for name, found in roles.items():
            if found.stem in STATES and whose.get(found.joint, 0) == k:
                own[name] = trial.columns[name][rows]
        states.append(Series(time[rows], own))
    read = {clock, *(name for series in states for name in series.columns)}
    acts = {name: trial.columns[name] for name in roles if name not in read}
    out, _ = merge(trial.path, states, [Series(time, acts)] if acts else [])
    lines = np.round(out.pop(LINE)).astype(np.int64)
    main = max(states, key=lambda series: len(series.time)).time
    begin = np.searchsorted(main, max(series.time[0] for series in states))
    columns = out | {"time": main[begin : begin + len(lines)]}
    turns = ", joints in turn" if len(groups) > 1 else ""
    times = f"each reading stands in about {np.mean([count for _, count in first]):.3g} rows"
    note = f"{times}{turns}: taken once, at the first of them"
    columns = {clock: columns.pop("time")} | columns
    return replace(trial, columns=columns, lines=lines, notes=(*trial.notes, note))


def _first_rows(q: np.ndarray) -> tuple[np.ndarray, float]:
    """Rows `[K]` in which angles `[T, n]` are new, and in how many rows each stands; 0 where that
    is no steady number, or an encoder's steps are what repeats.
    """
    step = np.abs(np.diff(np.nan_to_num(q), axis=0))
    rows = np.concatenate([[0], np.flatnonzero(np.any(step > 0, axis=1)) + 1])
    length = np.diff(rows)
    if len(rows) < REPEAT.min_readings:
        return rows, 0.0
    usual = int(np.median(length))
    even = np.mean((length >= usual) & (length <= usual + 1) | (length % usual == 0))
    moved = [x[x > 0] for x in step.T]
    fine = any(len(x) and np.median(x) > REPEAT.min_steps * np.min(x) for x in moved)
    steady = usual > 1 and even > REPEAT.min_even_share and fine
    return rows, float(np.mean(length[length <= usual + 1])) if steady else 0.0
