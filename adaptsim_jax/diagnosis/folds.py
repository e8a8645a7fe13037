"""Which stretches are left out together, and which stand together in a test."""

import numpy as np

LEAST_TRIALS = 5  # of which each is a fold
FOLDS, BLOCKS = 8, 24  # about so many of fewer trials; in a test


def folds_of(
    trial: np.ndarray, names: tuple[str, ...]
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Fold `[W]` and test block `[W]` of each stretch, and the folds' names.

    Folds are trials, or of fewer than `LEAST_TRIALS` about eight blocks of consecutive stretches: a
    few trials alone could not show what is not in each of them.
    """
    block = blocks_of(trial, BLOCKS)
    trials = np.unique(trial)
    if len(trials) >= LEAST_TRIALS:
        return np.searchsorted(trials, trial), block, tuple(names[t] for t in trials)
    fold = blocks_of(trial, FOLDS)
    first = [int(np.flatnonzero(fold == k)[0]) for k in range(fold.max() + 1)]
    part = [k - int(fold[trial == trial[i]].min()) for k, i in enumerate(first)]
    return (
        fold,
        block,
        tuple(f"{names[trial[i]]} part {p + 1}" for i, p in zip(first, part, strict=True)),
    )


def blocks_of(trial: np.ndarray, about: int) -> np.ndarray:
    """Block `[W]` of each stretch: about so many blocks of consecutive stretches of one trial, at
    least one a trial.
    """
    out, at = np.zeros(len(trial), int), 0
    for t in np.unique(trial):
        mine = np.flatnonzero(trial == t)
        parts = max(1, min(len(mine), round(about * len(mine) / len(trial))))
        for part in np.array_split(mine, parts):
            out[part], at = at, at + 1
    return out
