"""Which stretches or windows are left out together, and which stand together in a test.

Folds and blocks are made of the trial of each, in the order of time, by the same functions for
every objective.
"""

import numpy as np

from adaptsim_jax.diagnosis.criteria import FOLD


def folds_of(trial: np.ndarray, min_stretches: int = 1) -> np.ndarray:
    """Fold `[W]` of each stretch: trials, or of few trials about eight pieces of them.

    min_stretches: stretches of a piece.
    """
    names = np.unique(trial)
    if len(names) >= FOLD.min_trials:
        return np.searchsorted(names, trial)
    return pieces(trial, FOLD.pieces, min_stretches)


def apart_of(trial: np.ndarray) -> np.ndarray:
    """Part `[W]` of the log of each window: trials, or of fewer than three about a third of it."""
    names = np.unique(trial)
    if len(names) >= FOLD.apart:
        return np.searchsorted(names, trial)
    return pieces(trial, FOLD.apart)


def names_of(trial: np.ndarray, fold: np.ndarray, names: tuple[str, ...]) -> tuple[str, ...]:
    """What folds are called, by the names of the trials."""
    first = [int(np.flatnonzero(fold == k)[0]) for k in range(fold.max() + 1)]
    if len(np.unique(trial)) >= FOLD.min_trials:
        return tuple(names[trial[i]] for i in first)
    part = [k - int(fold[trial == trial[i]].min()) for k, i in enumerate(first)]
    return tuple(f"{names[trial[i]]} part {p + 1}" for i, p in zip(first, part, strict=True))


def blocks_of_windows(trial: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Block `[K]` of each window of the motion, of about `FOLD.span` s.

    time: `[K]` s, middles of the windows.

    The balance has more blocks than stretches have, since windows are short and many.
    """
    about = len(trial) * hop_of(trial, time) / FOLD.span
    return pieces(trial, int(np.clip(about, FOLD.min_blocks, FOLD.max_blocks)), FOLD.min_windows)


def hop_of(trial: np.ndarray, time: np.ndarray) -> float:
    """From window to window, s. trial, time: `[K]` of each."""
    if len(time) < 2:
        return 1.0
    return float(np.median(np.diff(time)[np.diff(trial) == 0]))


def pieces(trial: np.ndarray, about: int, min_stretches: int = 1) -> np.ndarray:
    """Piece `[W]` of each stretch: about so many pieces of consecutive stretches of one trial, at
    least one a trial.

    min_stretches: stretches of a piece, where a trial has them.
    """
    out, at = np.zeros(len(trial), int), 0
    for t in np.unique(trial):
        mine = np.flatnonzero(trial == t)
        most = max(1, len(mine) // min_stretches)
        parts = max(1, min(most, round(about * len(mine) / len(trial))))
        for part in np.array_split(mine, parts):
            out[part], at = at, at + 1
    return out
