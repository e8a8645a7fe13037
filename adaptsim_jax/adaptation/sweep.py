"""Many runs of Phase 1 and Phase 2 as one compiled program: seeds, hyper-parameters, targets."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.adaptation.episode import AdaptationEpisode, StepPlan
from adaptsim_jax.adaptation.phase1 import DistributionArchive, Phase1, Phase1Hyper, Phase1Info
from adaptsim_jax.adaptation.phase2 import adapt, draw_starts
from adaptsim_jax.adaptation.training import archive_size
from adaptsim_jax.core.progress import silent


class TrainedMany(NamedTuple):
    """`S` finished runs: hyper `[S]`, target-network weights `[S, n]`, S_E `[S, archive, ...]`,
    info `[S, rounds]`.
    """

    hyper: Phase1Hyper
    weights: jax.Array
    archive: DistributionArchive
    info: Phase1Info


def stack(hypers: list[Phase1Hyper]) -> Phase1Hyper:
    """Hyper-parameters side by side: leaves `[S]` float32."""
    return jax.tree.map(lambda *x: jnp.asarray(x, jnp.float32), *hypers)


def train_many(
    phase1: Phase1,
    hypers: Phase1Hyper,
    seeds: np.ndarray,
    *,
    progress: Callable = silent,
    program: Callable | None = None,
) -> TrainedMany:
    """Phase 1 for each of `seeds [S]` with the matching leaf of `hypers [S]`.

    One trace and one compiled program, called `S` times: on a CPU as fast as any number at once
    (`benchmarks/phase1.py --seeds`). program: `train_one` of this Phase 1 as it was compiled
    before, `(seeds [1], hypers [1])`.
    """
    train = program or jax.jit(partial(train_one, phase1))
    parts = []
    for i in range(len(seeds)):
        some = jax.tree.map(lambda x, i=i: x[i : i + 1], hypers)
        part = TrainedMany(some, *train(jnp.asarray(seeds[i : i + 1]), some))
        progress(i + 1, len(seeds), f"reward {float(part.info.final_reward[:, -1].mean()):.2f}")
        parts.append(part)
    return jax.tree.map(lambda *x: jnp.concatenate(x), *parts)


def train_one(
    phase1: Phase1, seeds: jax.Array, hypers: Phase1Hyper
) -> tuple[jax.Array, DistributionArchive, Phase1Info]:
    """Target-network weights `[S, n]`, S_E and info of `seeds [S]` side by side; pure."""
    rounds = jnp.arange(phase1.config.rounds)

    @jax.vmap
    def train(seed, hyper):
        state, info = phase1.run(phase1.init(jax.random.key(seed)), hyper, rounds)
        return state.learner.target, state.archive, info

    return train(seeds, hypers)


def starts_of(
    phase1: Phase1, trained: TrainedMany, seeds: np.ndarray, count: int
) -> DistributionArchive:
    """`[S, count, ...]`: for each run `count` members of its own S_E, drawn with its own seed."""
    used = archive_size(phase1, phase1.config.rounds)

    def one(seed, archive):
        return draw_starts(jax.random.fold_in(jax.random.key(seed), 1), archive, used, count)

    return jax.vmap(one)(jnp.asarray(seeds), trained.archive)


def adapt_many(
    phase1: Phase1,
    trained: TrainedMany,
    starts: DistributionArchive,
    targets: jax.Array | np.ndarray,
    *,
    iterations: int = 10,
) -> AdaptationEpisode:
    """Phase 2 of every run in each of `targets [T, D]` (physical) from its `starts [S, N, ...]`:
    `[S, T, N, I + 1, ...]`.
    """

    @jax.jit
    def run(targets, trained, starts):
        def one_run(weights, hyper, start):
            key, plan = jax.random.key(0), StepPlan(iterations, hyper.delta, hyper.shrink)

            def one_target(target):
                return adapt(key, phase1.task, phase1.bdq, weights, start, target, plan).history

            return jax.vmap(one_target)(targets)

        return jax.lax.map(lambda a: one_run(*a), (trained.weights, trained.hyper, starts))

    return run(jnp.asarray(targets, jnp.float32), trained, starts)
