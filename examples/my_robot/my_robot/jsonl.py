"""A log reader: a JSON object in each line, with the time, angles and torques of all joints."""

import json
from pathlib import Path

import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.readers import Reader, Wanted
from adaptsim_jax.logs.tables import RawTrial

STEMS = {"angles": "q", "torques": "tau"}  # of the file -> ours


def read(path: Path, wanted: Wanted) -> list[RawTrial]:
    """The one trial of a file. Raises BadInput at a line that is no such object."""
    rows = []
    for number, line in enumerate(path.read_text().splitlines(), 1):
        try:
            row = json.loads(line)
            rows.append([row["time"], *(x for name in STEMS for x in row[name])])
        except (ValueError, KeyError, TypeError) as error:
            raise BadInput(f"{path}: line {number}: {error!r}; mend or remove it") from None
    table = np.array(rows, float)
    joints = (table.shape[1] - 1) // 2
    names = ["time", *(f"{stem}{j + 1}" for stem in STEMS.values() for j in range(joints))]
    columns = dict(zip(names, table.T, strict=True))
    return [RawTrial(path.stem, str(path), columns, np.arange(1, len(rows) + 1))]


READER = Reader(read, (".jsonl",))
