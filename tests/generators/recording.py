"""A recording as a logger has it, and its files."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np


@dataclass
class Dataset:
    """A recording. trials: one dictionary of columns `[K]` each; truth: what nobody who measures
    would know.
    """

    trials: list[dict[str, np.ndarray]]
    meta: dict
    truth: dict = field(default_factory=dict)


def write_dataset(ds: Dataset, folder: str | Path, digits: int = 9) -> Path:
    """Write `meta.toml` and one CSV a trial, as a user's logger would; the truth is not written."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    lines, tables = [], []
    for key, value in ds.meta.items():
        if isinstance(value, dict):
            tables += ["", f"[{key}]", *(f"{k} = {v!r}" for k, v in value.items())]
        else:
            lines.append(f'{key} = "{value}"')
    (folder / "meta.toml").write_text("\n".join(lines + tables) + "\n")
    for i, columns in enumerate(ds.trials):
        table = np.stack(list(columns.values()), 1)
        name = folder / f"trial_{i:02d}.csv"
        np.savetxt(
            name, table, fmt=f"%.{digits}g", delimiter=",", header=",".join(columns), comments=""
        )
    return folder
