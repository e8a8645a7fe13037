"""Phase 2: adapt to a target with the trained adaptation policy, greedily (paper, Algorithm 2)."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from adaptsim_jax.adaptation.episode import AdaptationEpisode, StepPlan, run_episode
from adaptsim_jax.adaptation.phase1 import DistributionArchive
from adaptsim_jax.learners.bdq import BDQ
from adaptsim_jax.space import gaussian
from adaptsim_jax.tasks.base import Task

RADIUS = (
    0.6  # of Omega's ranges: how far from each other means may be whose returns tell of each other
)


class Phase2Result(NamedTuple):
    """The best policy found, and how it was found.

    policy: the task policy with the highest raw return, or where the task has its doubts of single
        returns the highest expected one;
    mean: `[D]`, its distribution (unit coordinates); score, reward: `[]`, its raw return and scaled
        reward; history: `AdaptationEpisode` with leading axis `[N]`, one for each initial distribution.
    """  # noqa: E501

    policy: Any
    mean: jax.Array
    score: jax.Array
    reward: jax.Array
    history: AdaptationEpisode


def draw_starts(
    key: jax.Array, archive: DistributionArchive, used: jax.Array | int, count: int
) -> DistributionArchive:
    """`count` of the first `used` members of S_E, uniformly: leading axis `[count]`."""
    index = jax.random.randint(key, (count,), 0, used)
    return jax.tree.map(lambda x: x[index], archive)


def adapt(
    key: jax.Array,
    task: Task,
    bdq: BDQ,
    weights: jax.Array,
    starts: DistributionArchive,
    target: jax.Array,
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


def best_visit(score: Any) -> tuple[jax.Array, jax.Array]:
    """`(start, visit)`, each `[]`, of the highest finite raw return of `score [N, I + 1]`; the
    first visit where none is finite.
    """
    finite = jnp.where(jnp.isfinite(score), score, -jnp.inf)
    start, visit = jnp.unravel_index(jnp.argmax(finite), finite.shape)
    return start, visit


def smoothed(mean: jax.Array, score: jax.Array, doubt: float) -> jax.Array:
    """Returns `[N]` expected at each visit, of the returns `score [N]` of all of them: a Gaussian
    process over `mean [N, D]` (unit coordinates) of a fixed length, since visits are too few to fit
    one.

    doubt: variance of a visit's return by luck, over that by E's mean; 0 leaves returns as they
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


def chosen_visit(history: AdaptationEpisode, doubt: float = 0.0) -> tuple[jax.Array, jax.Array]:
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
