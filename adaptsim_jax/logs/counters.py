"""Counters of rows that show what a recorder dropped while it stamped the others evenly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from adaptsim_jax.logs.columns import COUNTERS, roles_of
from adaptsim_jax.logs.criteria import HOLE, JITTER
from adaptsim_jax.logs.tables import RawTrial


def counted(trial: RawTrial) -> RawTrial:
    """The trial at times by its counter of rows, and a note, where that leaves numbers out and even
    stamps do not.
    """
    columns = {name: x for name, x in trial.columns.items() if name not in COUNTERS}
    clock = next((name for name, found in roles_of(columns).items() if found.stem == "time"), None)
    for name in trial.columns.keys() - columns.keys():
        missing = np.diff(trial.columns[name]) - 1.0
        if clock is None or not (np.all(missing >= 0) and np.all(missing == np.round(missing))):
            continue
        steps = np.diff(columns[clock])
        usual = float(np.median(steps)) if len(steps) else 0.0
        few = 0 < np.count_nonzero(missing) < HOLE.counted * len(missing)
        if few and np.ptp(steps) < JITTER.even * usual:
            rows = np.concatenate([[0.0], np.cumsum(missing)])
            note = (
                f"{name} leaves out {missing.sum():.0f} rows in {np.count_nonzero(missing)} holes, "
                "which even stamps deny: times are taken by it"
            )
            columns[clock] = columns[clock] + usual * rows
            return replace(trial, columns=columns, notes=(*trial.notes, note))
    return replace(trial, columns=columns)
