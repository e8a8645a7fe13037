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
    clock = next((name for name, column_role in roles.items() if column_role.stem == "time"), None)
    angles = {
        column_role.joint: name for name, column_role in roles.items() if column_role.stem == "q"
    }
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
    group_of = {joint: k for k, group in enumerate(groups) for joint in group}
    for k, (rows, _) in enumerate(first):
        columns_of_group = {} if states else {LINE: trial.lines[rows].astype(float)}
        for name, column_role in roles.items():
            if column_role.stem in STATES and group_of.get(column_role.joint, 0) == k:
                columns_of_group[name] = trial.columns[name][rows]
        states.append(Series(time[rows], columns_of_group))
    state_columns = {clock, *(name for series in states for name in series.columns)}
    held_columns = {name: trial.columns[name] for name in roles if name not in state_columns}
    merged, _ = merge(trial.path, states, [Series(time, held_columns)] if held_columns else [])
    lines = np.round(merged.pop(LINE)).astype(np.int64)
    main = max(states, key=lambda series: len(series.time)).time
    begin = np.searchsorted(main, max(series.time[0] for series in states))
    columns = merged | {"time": main[begin : begin + len(lines)]}
    in_turn = ", joints in turn" if len(groups) > 1 else ""
    times = f"each reading stands in about {np.mean([count for _, count in first]):.3g} rows"
    note = f"{times}{in_turn}: taken once, at the first of them"
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
    usual_length = int(np.median(length))
    share_even = np.mean(
        (length >= usual_length) & (length <= usual_length + 1) | (length % usual_length == 0)
    )
    nonzero_steps = [x[x > 0] for x in step.T]
    is_fine = any(len(x) and np.median(x) > REPEAT.min_steps * np.min(x) for x in nonzero_steps)
    is_steady = usual_length > 1 and share_even > REPEAT.min_even_share and is_fine
    return rows, float(np.mean(length[length <= usual_length + 1])) if is_steady else 0.0
