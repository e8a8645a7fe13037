"""What lies in a folder of recordings and is no trial of its own: copies, tables of other things,
and files that are not read.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from adaptsim_jax.logs.columns import SPELLINGS
from adaptsim_jax.logs.csv_rows import is_number

UNREAD = SPELLINGS["unread"]
"""Endings of files that are not read: `packed`, `texts`, `others`."""
MAX_LISTED = 4
"""Names that one line lists."""


def copies(trials: Sequence[tuple[str, np.ndarray]]) -> tuple[str, ...]:
    """A note on each trial (name, angles `[T, n]`) whose angles are those of an earlier one."""
    notes, seen_by_shape = [], {}
    for (
        name,
        q,
    ) in trials:  # only those of one length and about one sum are compared: there may be a thousand
        same_shape = seen_by_shape.setdefault((q.shape, round(float(np.nansum(q)), 3)), [])
        equal = (
            earlier
            for earlier, other in same_shape
            if np.allclose(q, other, rtol=1e-6, atol=1e-9, equal_nan=True)
        )
        if (earlier := next(equal, None)) is not None:
            notes.append(
                f"{name} holds the angles of {earlier}: a copy? leave it out (--without {name})"
            )
        same_shape.append((name, q))
    return tuple(notes)


def strays(
    headers: Mapping[Path, Sequence[str]], is_time: Callable[[str], bool]
) -> tuple[Path, ...]:
    """Tables that are no logs, as lists of the trials are: without a time, and without any column
    of those that have one.
    """
    logs = {path for path, header in headers.items() if any(map(is_time, header))}
    theirs = {name for path in logs for name in headers[path] if name}

    def alike(header):
        return (
            len(header) < 2 or theirs & set(header) or any(map(is_number, header))
        )  # a trial cut short, or bare

    return tuple(
        path for path, header in headers.items() if logs and path not in logs and not alike(header)
    )


def left_out(path: Path) -> str:
    """A note on one of `strays`."""
    return f"{path.name} is left out: it has no time and no column of the other files"


def unread(folder: str | Path) -> tuple[str, ...]:
    """A note on packed files, and on folders that hold tables, but for those of a diagnosis."""
    folder = Path(folder)
    if not folder.is_dir():
        return ()

    def holds(p, pattern):
        return next(p.glob(pattern), None) is not None

    inner = sorted(
        p.name
        for p in folder.iterdir()
        if p.is_dir()
        and (holds(p, "*.csv") or holds(p, "*.npz"))
        and not (p / "report.json").exists()
    )
    notes = []
    if packed := _ending(folder, UNREAD["packed"]):
        notes.append(f"not read: {_some(packed)}; unpack, or export as CSV")
    if inner:
        moved = "move them up, each by the name of its trial"
        notes.append(f"not read: tables in the folder {_some(inner)}; {moved}")
    return tuple(notes)


def instead(folder: Path) -> str:
    """What lies in a folder without recordings, and how it is read, to follow what is said of that;
    '' where nothing does.
    """
    notes = list(unread(folder))
    if folder.is_dir() and (texts := _ending(folder, UNREAD["texts"])):
        notes.append(f"not read: {_some(texts)}; rename those that are tables to .csv")
    if folder.is_dir() and (others := _ending(folder, UNREAD["others"])):
        notes.append(f"not read: {_some(others)}; export as CSV")
    return "".join(f"; {note}" for note in notes)


def _ending(folder: Path, endings: Sequence[str]) -> list[str]:
    found = (
        p.name
        for p in folder.iterdir()
        if p.is_file() and p.suffix.lower() in endings and p.name[0] != "."
    )
    return sorted(
        found, key=lambda name: [int(s) if s.isdigit() else s for s in re.split(r"(\d+)", name)]
    )


def _some(names: Sequence[str]) -> str:
    """The first of these names, and how many more there are."""
    if len(names) > MAX_LISTED:
        more = f" and {len(names) - MAX_LISTED} more"
    else:
        more = ""
    return f"{', '.join(names[:MAX_LISTED])}{more}"
