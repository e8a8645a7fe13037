"""Options of an environment's task by a diagnosis: the simulator has what was found, Omega is what
the data leave open, and E begins at what they say.
"""

from pathlib import Path

from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.environments.targets import DECLARED
from adaptsim_jax.mend.randomisation import FILE, Randomised, read_randomisation

KNOWN = 0.02
"""Half the width of an interval over its centre, below which a number is not moved: policies do not
tell such worlds apart."""
WIDER = 2.0
"""What intervals are multiplied by: a policy that knows E is trained beyond what 90 % cover."""


def diagnosed(options: Table, folder: str | Path) -> Table:
    """`options` of `EnvironmentConfig` with the model, Omega and E's first mean of the diagnosis in
    `folder`.

    Targets stay the declared machine with what their tables say, unless they name a model. Omega
    has the fields that `options` name, in the ranges of the diagnosis where it knows them, and what
    was found besides. BadInput where nothing is left to move.
    """
    path = Path(folder) / FILE
    if not path.exists():
        raise BadInput(
            f"{path}: no such file; give the folder that `adaptsim diagnose --out` wrote"
        )
    known = {row.name: row for row in read_randomisation(path).rows}
    fields: Table = {}
    start: dict[str, float] = {}
    for name, given in options.get("fields", {}).items():
        fields[name] = given if name not in known else _range(known[name])
    for name, row in known.items():
        if row.source != "file":
            fields[name] = _range(row)
    fields = {n: ends for n, ends in fields.items() if n not in known or _moves(known[n])}
    if not fields:
        raise BadInput(
            f"{path}: every number is known to within {KNOWN:.0%}, so there is nothing to adapt; "
            "name in [fields] what may still move"
        )
    for name in fields:
        if name in known:
            start[name] = known[name].centre
    model = str((Path(folder) / "model.toml").resolve())
    tables = options.get("targets") or {"nominal": {}}
    targets = {name: {"model": DECLARED} | dict(table) for name, table in tables.items()}
    return options | {"model": model, "fields": fields, "start": start, "targets": targets}


def _range(row: Randomised) -> list[float]:
    """The range of a field, which does not change its sign."""
    low = row.centre - WIDER * (row.centre - row.low)
    high = row.centre + WIDER * (row.high - row.centre)
    if row.centre > 0.0:
        low = max(low, 0.1 * row.centre)
    return [low, high]


def _moves(row: Randomised) -> bool:
    return row.high - row.low > 2.0 * KNOWN * abs(row.centre)
