"""AdaptSim as a row of the comparison: Phase 1 over seeds at once, then Phase 2 in every target."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.adapt.phase1 import Phase1, Phase1Hyper, Phase1State, make_phase1
from adaptsim_jax.adapt.training import TrainConfig, Trained, adapt_run, traced
from adaptsim_jax.progress import silent
from adaptsim_jax.tasks.base import Task


def train_seeds(
    task: Task, config: TrainConfig, keys: jax.Array, hyper: Phase1Hyper | None = None, report: Callable = silent
) -> tuple[Phase1, Phase1Hyper, Phase1State]:
    """Phase 1 for each of `keys [S]` in one compiled program; leaves of `hyper` may carry a leading axis `[S]`.

    Returns the final states with leading axis `[S]`. `report(done, total, note)` is called between chunks of rounds.
    """
    phase1 = make_phase1(task, config.phase1)
    hyper = traced(config.hyper if hyper is None else hyper)
    axes = jax.tree.map(lambda leaf: 0 if jnp.ndim(leaf) else None, hyper)
    state = jax.jit(jax.vmap(phase1.init))(keys)
    total = phase1.config.rounds
    size = max(n for n in range(1, max(1, total // 10) + 1) if total % n == 0)
    advance = jax.jit(jax.vmap(phase1.run, in_axes=(0, axes, None)), donate_argnums=0)
    for done in range(0, total, size):
        state, info = advance(state, hyper, jnp.arange(done, done + size))
        report(done + size, total, f"reward {float(jnp.mean(info.final_reward[:, -1])):.2f}")
    return phase1, hyper, state


def adapt_seeds(
    trained: tuple[Phase1, Phase1Hyper, Phase1State],
    keys: jax.Array,
    targets: np.ndarray,
    *,
    starts: int = 2,
    iterations: int = 10,
) -> np.ndarray:
    """Phase 2 of every seed in every target `[T, D]` (physical): means visited, `[T, S, N, iterations + 1, D]`.

    A seed takes the same `starts` members of its S_E in all targets.
    """
    phase1, hyper, state = trained
    axes = jax.tree.map(lambda leaf: 0 if jnp.ndim(leaf) else None, hyper)

    def one(key, seed_state, seed_hyper, target):
        run = Trained(phase1, seed_hyper, seed_state, phase1.config.rounds)
        return adapt_run(run, key, target, starts=starts, iterations=iterations).history.mean

    over_seeds = jax.vmap(one, in_axes=(0, 0, axes, None))
    over_targets = jax.jit(jax.vmap(over_seeds, in_axes=(None, None, None, 0)))
    return np.asarray(over_targets(keys, state, hyper, jnp.asarray(targets, jnp.float32)))


def best_over(costs: np.ndarray) -> np.ndarray:
    """The cost of the best of the N distributions at each iteration: `[..., N, I + 1] -> [..., I + 1]`; NaN never wins."""
    return np.nanmin(np.where(np.isfinite(costs), costs, np.inf), axis=-2)
