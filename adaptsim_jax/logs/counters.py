"""Counters of rows that show what a recorder dropped while it stamped the others evenly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from adaptsim_jax.logs.columns import COUNTERS, roles_of
from adaptsim_jax.logs.criteria import JITTER
from adaptsim_jax.logs.tables import RawTrial


def counted(trial: RawTrial) -> RawTrial:
    """The trial at times by its counter of rows, and a note, where that leaves numbers out and even
    stamps do not.
    """
    columns = {name: x for name, x in trial.columns.items() if name not in COUNTERS}
    clock = next(
        (name for name, column_role in roles_of(columns).items() if column_role.stem == "time"),
        None,
    )
    for name in trial.columns.keys() - columns.keys():
        missing = np.diff(trial.columns[name]) - 1.0
        steps = [] if clock is None else np.diff(columns[clock])
        is_whole = len(steps) > 0 and np.all(missing >= 0) and np.all(missing == np.round(missing))
        if is_whole and np.any(missing) and not np.median(missing):
            usual_step = float(np.median(steps))
            if np.ptp(steps) < JITTER.max_uneven_share * usual_step:
                delay = usual_step * np.concatenate([[0.0], np.cumsum(missing)])
                columns[str(clock)] = columns[str(clock)] + delay
                note = f"{name} leaves out {missing.sum():.0f} rows, which even stamps deny: times"
                return replace(
                    trial, columns=columns, notes=(*trial.notes, f"{note} are taken by it")
                )
    return replace(trial, columns=columns)
