"""AdaptSim as a row of the comparison: Phase 1 of all seeds and hyper-parameters in one program,
Phase 2 in every target.
"""

from collections.abc import Callable, Sequence

import numpy as np

from adaptsim_jax.adaptation.phase1 import Phase1Config, Phase1Hyper, make_phase1
from adaptsim_jax.adaptation.sweep import adapt_many, stack, starts_of, train_many
from adaptsim_jax.core.progress import silent
from adaptsim_jax.tasks.base import Task


def adaptsim_means(
    task: Task,
    sizes: Phase1Config,
    hypers: Sequence[Phase1Hyper],
    seeds: np.ndarray,
    targets: np.ndarray,
    *,
    starts: int = 2,
    iterations: int = 10,
    report: Callable = silent,
) -> np.ndarray:
    """Means visited `[H, T, S, N, iterations + 1, D]` for each of `hypers` (H), `targets [T, D]`
    and `seeds [S]`.

    One compiled Phase 1 serves all `H x S` runs, and one Phase 2 all targets. The N starts are
    drawn from a run's own S_E, with its own seed.
    """
    phase1 = make_phase1(task, sizes)
    every = np.tile(np.asarray(seeds), len(hypers))
    many = stack([hyper for hyper in hypers for _ in seeds])
    trained = train_many(phase1, many, every, progress=report)
    first = starts_of(phase1, trained, every, starts)
    means = np.asarray(adapt_many(phase1, trained, first, targets, iterations=iterations).mean)
    return means.reshape(len(hypers), len(seeds), *means.shape[1:]).swapaxes(1, 2)


def best_over(costs: np.ndarray) -> np.ndarray:
    """Cost of the best of the N distributions at each iteration, `[..., N, I + 1] -> [..., I + 1]`;
    NaN never wins.
    """
    return np.min(np.where(np.isfinite(costs), costs, np.inf), axis=-2)
