"""What reads logs: one record for each kind of file, ours and those of other packages.

Another package adds one by an entry point of the group `adaptsim.log_readers`. CSV and NPZ files
are read by `tables.py`, and go together with what other readers find in a folder.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from adaptsim_jax.core.registry import Registry
from adaptsim_jax.logs.tables import RawTrial


@dataclass(frozen=True)
class Wanted:
    """What is asked of a reader.

    - `options`: Of `[ros]`.
    - `ignore`: Columns or joints that are left out.
    - `joints`: The model's, empty where not known.
    - `named`: The file's names that `[columns]` speaks of.
    - `servos`: Columns of commands that are targets -> their joints.
    - `out`: Whether a trial of this name is left out, and may come without its columns.
    """

    options: Mapping[str, str | Sequence[str]] = field(default_factory=dict)
    ignore: Collection[str] = ()
    joints: Sequence[str] = ()
    named: Collection[str] = ()
    servos: Mapping[str, str] = field(default_factory=dict)
    out: Callable[[str], bool] = lambda name: False


@dataclass(frozen=True)
class Reader:
    """Reads one kind of file, or folder, as raw trials of named columns.

    - `read`: `(path, wanted) -> trials`, columns as written; `BadInput` names file, row and mend.
    - `endings`: Of its files, as `.jsonl`.
    - `find`: What of a path it reads, those files where None.
    - `check`: `(path, trial, joints)`, after `[columns]` has named the columns of the first trial.
    """

    read: Callable[[Path, Wanted], list[RawTrial]]
    endings: tuple[str, ...] = ()
    find: Callable[[Path], list[Path]] | None = None
    check: Callable[[Path, RawTrial, Sequence[str]], None] | None = None

    def paths(self, data: Path) -> list[Path]:
        """What of a file or a folder this reader reads, in order."""
        if self.find is not None:
            return self.find(data)
        files = sorted(data.iterdir()) if data.is_dir() else [data]
        return [p for p in files if p.suffix.lower() in self.endings and not p.name.startswith(".")]


READERS: Registry[Reader] = Registry(
    "log_readers",
    {"bag": "adaptsim_jax.logs.ros:READER", "lerobot": "adaptsim_jax.logs.lerobot:READER"},
    type="Reader",
)


def found(data: Path) -> list[tuple[Reader, Path]]:
    """What of a file or a folder is read, and by which reader; CSV and NPZ files apart."""
    return [(reader, path) for reader in READERS.values() for path in reader.paths(data)]


def endings() -> tuple[str, ...]:
    """Return the endings of all files that are read, but for CSV and NPZ."""
    return tuple(ending for reader in READERS.values() for ending in reader.endings)
