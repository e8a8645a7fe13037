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
    one by its mean. As it is where readings do not stand in about as many rows each.
    """
    roles = roles_of(trial.columns)
    clock = next((name for name, found in roles.items() if found.stem == "time"), None)
    angles = [trial.columns[name] for name, found in roles.items() if found.stem == "q"]
    if clock is None or not angles:
        return trial
    rows, count = _first_rows(np.stack(angles, 1))
    if not count:
        return trial
    acts = {n: x for n, x in trial.columns.items() if n in roles and roles[n].stem not in STATES}
    acts.pop(clock)
    lasting = {n: x[rows] for n, x in trial.columns.items() if n not in acts and n != clock}
    lasting[LINE] = trial.lines[rows].astype(float)
    time = trial.columns[clock]
    commands = [Series(time, acts)] if acts else []
    out, _ = merge(trial.path, [Series(time[rows], lasting)], commands)
    lines = np.round(out.pop(LINE)).astype(np.int64)
    columns = {clock: time[rows][-len(lines) :]} | {n: x for n, x in out.items() if n != "time"}
    note = f"each reading stands in about {count:.3g} rows: taken once, at the first of them"
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
    fine = any(len(x) and np.median(x) > REPEAT.steps * np.min(x) for x in moved)
    steady = usual > 1 and even > REPEAT.even and fine
    return rows, float(np.mean(length[length <= usual + 1])) if steady else 0.0
