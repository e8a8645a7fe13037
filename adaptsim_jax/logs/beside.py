"""What lies in a folder of recordings and is no trial of its own: copies, tables of other things, and files that are not read."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from adaptsim_jax.logs.csv_rows import is_number

PACKED = (".gz", ".zip", ".xz", ".bz2", ".7z", ".tar", ".xlsx", ".xls", ".ods", ".mat", ".pkl")
"""Endings of files that may hold a trial and are not read."""


def copies(trials: Sequence[tuple[str, np.ndarray]]) -> tuple[str, ...]:
    """A note on each trial (name, angles `[T, n]`) whose angles are those of an earlier one."""
    notes, known = [], {}
    for name, q in trials:  # only those of one length and about one sum are compared: there may be a thousand
        alike = known.setdefault((q.shape, round(float(np.nansum(q)), 3)), [])
        same = (earlier for earlier, other in alike if np.allclose(q, other, rtol=1e-6, atol=1e-9, equal_nan=True))
        if (earlier := next(same, None)) is not None:
            notes.append(f"{name} holds the angles of {earlier}: a copy? leave it out (--without {name})")
        alike.append((name, q))
    return tuple(notes)


def strays(headers: Mapping[Path, Sequence[str]], is_time: Callable[[str], bool]) -> tuple[Path, ...]:
    """Tables that are no logs, as lists of the trials are: without a time, and without any column of those that have one."""
    logs = {path for path, header in headers.items() if any(map(is_time, header))}
    theirs = {name for path in logs for name in headers[path] if name}
    alike = lambda header: (
        len(header) < 2 or theirs & set(header) or any(map(is_number, header))
    )  # a trial cut short, or bare
    return tuple(path for path, header in headers.items() if logs and path not in logs and not alike(header))


def left_out(path: Path) -> str:
    """A note on one of `strays`."""
    return f"{path.name} is left out: it has no time and no column of the other files"


def unread(folder: str | Path) -> tuple[str, ...]:
    """A note on packed files, and on folders that hold tables, but for those of a diagnosis."""
    folder = Path(folder)
    if not folder.is_dir():
        return ()
    packed = sorted(p.name for p in folder.iterdir() if p.is_file() and p.suffix.lower() in PACKED)
    holds = lambda p, pattern: next(p.glob(pattern), None) is not None
    inner = sorted(
        p.name
        for p in folder.iterdir()
        if p.is_dir() and (holds(p, "*.csv") or holds(p, "*.npz")) and not (p / "report.json").exists()
    )
    notes = [f"not read: {', '.join(packed)}; unpack, or export as CSV"] if packed else []
    return (*notes, *([f"not read: tables in the folder {', '.join(inner)}; move them up"] if inner else []))
