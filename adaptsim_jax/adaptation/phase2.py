"""Phase 2: adapt to a target with the trained adaptation policy, greedily (paper, Algorithm 2)."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from adaptsim_jax.adaptation.episode import AdaptationEpisode, StepPlan, run_episode
from adaptsim_jax.adaptation.memory import seeds_at_once
from adaptsim_jax.adaptation.phase1 import (
    DistributionArchive,
    Phase1,
    Phase1Hyper,
    Phase1Info,
    archive_size,
)
from adaptsim_jax.core.progress import silent
from adaptsim_jax.learners.bdq import BDQ
from adaptsim_jax.space import gaussian
from adaptsim_jax.tasks.base import Task
from adaptsim_jax.tasks.engine import filled_batches

RADIUS = (
    0.6  # of Omega's ranges: how far from each other means may be whose returns tell of each other
)


class Phase2Result(NamedTuple):
    """The best policy found, and how it was found.

    policy: The task policy with the highest raw return, or where the task has its doubts of single
        returns the highest expected one;
    mean: `[D]`, its distribution (unit coordinates); score, reward: `[]`, its raw return and scaled
        reward; history: `AdaptationEpisode` with leading axis `[N]`, one for each initial distribution.
    """  # noqa: E501

    policy: Any
    mean: Array
    score: Array
    reward: Array
    history: AdaptationEpisode


def draw_starts(
    key: Array,
    archive: DistributionArchive,
    used: Array | int,
    count: int,
    first: Any = None,
) -> DistributionArchive:
    """`count` of the first `used` members of S_E, uniformly: leading axis `[count]`. first: E's
    mean `[D]` (unit coordinates) in the first of them, where the task has one.
    """
    index = jax.random.randint(key, (count,), 0, used)
    drawn = jax.tree.map(lambda x: x[index], archive)
    if first is None:
        return drawn
    return drawn._replace(mean=drawn.mean.at[0].set(jnp.asarray(first, drawn.mean.dtype)))


def adapt(
    key: Array,
    task: Task,
    bdq: BDQ,
    weights: Array,
    starts: DistributionArchive,
    target: Array,
    plan: StepPlan = StepPlan(),  # noqa: B008
) -> Phase2Result:
    """Adapt each of the `N` starts with greedy steps in `target: [D]` (physical values).

    Pure: vmap over targets, seeds (weights and starts together) or starts. A return that is not
    finite never wins.
    """

    def act(_, obs):
        return bdq.greedy(weights, obs)

    def one(key, start):
        dist = gaussian(task.space, start.mean)
        return run_episode(key, task, act, dist, start.policy, target, plan)

    history = jax.vmap(one)(jax.random.split(key, starts.mean.shape[0]), starts)
    return best_of(history, task.doubt)


def best_visit(score: Any) -> tuple[Array, Array]:
    """`(start, visit)`, each `[]`, of the highest finite raw return of `score [N, I + 1]`; the
    first visit where none is finite.
    """
    finite = jnp.where(jnp.isfinite(score), score, -jnp.inf)
    start, visit = jnp.unravel_index(jnp.argmax(finite), finite.shape)
    return start, visit


def smoothed(mean: Array, score: Array, doubt: float) -> Array:
    """Returns `[N]` expected at each visit, of the returns `score [N]` of all of them: a Gaussian
    process over `mean [N, D]` (unit coordinates) of a fixed length, since visits are too few to fit
    one.

    doubt: Variance of a visit's return by luck, over that by E's mean; 0 leaves returns as they
    are. What is not finite stays so.
    """
    if doubt == 0:
        return score
    sound = jnp.isfinite(score)
    on, known = sound.astype(mean.dtype), jnp.where(sound, score, 0.0)
    squares = jnp.sum(jnp.square(mean[:, None] - mean[None]), -1)
    alike = jnp.exp(-0.5 * squares / RADIUS**2) * jnp.outer(on, on)

    def weigh(y):
        return jnp.linalg.solve(alike + doubt * jnp.eye(len(score)), y)

    level = on @ weigh(known) / jnp.maximum(on @ weigh(on), 1e-9)
    return jnp.where(sound, level + alike @ weigh(known - level * on), score)


def chosen_visit(history: AdaptationEpisode, doubt: float = 0.0) -> tuple[Array, Array]:
    """`(start, visit)`, each `[]`, of what is deployed of `history: [N, I + 1, ...]`: the highest
    of its smoothed returns.
    """
    mean, score = history.mean, history.score
    return best_visit(
        smoothed(mean.reshape(-1, mean.shape[-1]), score.reshape(-1), doubt).reshape(score.shape)
    )


def best_of(history: AdaptationEpisode, doubt: float = 0.0) -> Phase2Result:
    """The visit with the highest finite return, smoothed where there is `doubt`, over all of
    `history: [N, I + 1, ...]`.
    """
    start, visit = chosen_visit(history, doubt)

    def pick(x):
        return x[start, visit]

    policy = jax.tree.map(pick, history.policy)
    return Phase2Result(
        policy, pick(history.mean), pick(history.score), pick(history.reward), history
    )


# ---------------------------------------------------------------- many runs
#
# Many runs of Phase 1 and Phase 2 as one compiled program: seeds, hyper-parameters, targets.


class TrainedMany(NamedTuple):
    """`S` finished runs: hyper `[S]`, target-network weights `[S, n]`, S_E `[S, archive, ...]`,
    info `[S, rounds]`.
    """

    hyper: Phase1Hyper
    weights: Array
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
    at_once: int | None = None,
    progress: Callable = silent,
    program: Callable | None = None,
) -> TrainedMany:
    """Phase 1 for each of `seeds [S]` with the matching leaf of `hypers [S]`, one compiled program
    for all. Each is the run alone, to rounding.

    at_once: Runs side by side, by default what memory allows (`seeds_at_once`). program:
    `train_one` of this Phase 1 as it was compiled before.
    """
    train = program or jax.jit(partial(train_one, phase1))
    total, parts = len(seeds), []
    width = at_once or seeds_at_once(phase1.task, phase1.config, total)
    for place, rows in filled_batches(total, width):
        some = jax.tree.map(lambda x, r=rows: x[r], hypers)
        part = TrainedMany(some, *train(jnp.asarray(seeds[rows]), some))
        progress(place.stop, total, f"reward {float(part.info.final_reward[:, -1].mean()):.2f}")
        parts.append(part)
    return jax.tree.map(lambda *x: jnp.concatenate(x)[:total], *parts)


def train_one(
    phase1: Phase1, seeds: Array, hypers: Phase1Hyper
) -> tuple[Array, DistributionArchive, Phase1Info]:
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
    targets: Array | np.ndarray,
    *,
    iterations: int = 10,
    at_once: int | None = None,
) -> AdaptationEpisode:
    """Phase 2 of every run in each of `targets [T, D]` (physical) from its `starts [S, N, ...]`:
    `[S, T, N, I + 1, ...]`. at_once: As `train_many` has it.
    """
    width = at_once or seeds_at_once(phase1.task, phase1.config, len(trained.weights))

    @jax.jit
    def run(targets, trained, starts):
        def one_run(weights, hyper, start):
            key, plan = jax.random.key(0), StepPlan(iterations, hyper.delta, hyper.shrink)

            def one_target(target):
                return adapt(key, phase1.task, phase1.bdq, weights, start, target, plan).history

            return jax.vmap(one_target)(targets)

        every = trained.weights, trained.hyper, starts
        side_by_side = width if width > 1 else None
        return jax.lax.map(lambda a: one_run(*a), every, batch_size=side_by_side)

    return run(jnp.asarray(targets, jnp.float32), trained, starts)
