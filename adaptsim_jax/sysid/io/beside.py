"""What lies in a folder of recordings and is no trial of its own: copies, and files that are not read."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

PACKED = (".gz", ".zip", ".xz", ".bz2", ".7z", ".tar", ".xlsx", ".xls", ".ods", ".mat", ".pkl")
"""Endings of files that may hold a trial and are not read."""


def copies(trials: Sequence[tuple[str, np.ndarray]]) -> tuple[str, ...]:
    """A note on each trial (name, angles `[T, n]`) whose angles are those of an earlier one."""
    notes = []
    for k, (name, q) in enumerate(trials):
        for earlier, other in trials[:k]:
            if q.shape == other.shape and np.allclose(q, other, rtol=1e-6, atol=1e-9, equal_nan=True):
                notes.append(f"{name} holds the angles of {earlier}: a copy? leave it out (--without {name})")
                break
    return tuple(notes)


def unread(folder: str | Path) -> tuple[str, ...]:
    """A note on packed files, and on folders that hold tables."""
    folder = Path(folder)
    if not folder.is_dir():
        return ()
    packed = sorted(p.name for p in folder.iterdir() if p.is_file() and p.suffix.lower() in PACKED)
    inner = sorted(p.name for p in folder.iterdir() if p.is_dir() and (any(p.glob("*.csv")) or any(p.glob("*.npz"))))
    notes = [f"not read: {', '.join(packed)}; unpack, or export as CSV"] if packed else []
    return (*notes, *([f"not read: tables in the folder {', '.join(inner)}; move them up"] if inner else []))
