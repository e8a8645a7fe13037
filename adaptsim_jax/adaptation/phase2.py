"""Phase 2: adapt to a target with the trained adaptation policy, greedily (paper, Algorithm 2)."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from adaptsim_jax.adaptation.episode import Episode, run_episode
from adaptsim_jax.adaptation.phase1 import Archive
from adaptsim_jax.learners.bdq import BDQ
from adaptsim_jax.space import gaussian
from adaptsim_jax.tasks.base import Task


class Phase2Result(NamedTuple):
    """The best policy found, and how it was found.

    policy: the task policy with the highest raw return; mean: `[D]`, its distribution (unit coordinates); score,
    reward: `[]`, its raw return and scaled reward; history: `Episode` with leading axis `[N]`, one for each
    initial distribution.
    """

    policy: Any
    mean: jax.Array
    score: jax.Array
    reward: jax.Array
    history: Episode


def draw_starts(key: jax.Array, archive: Archive, used: jax.Array | int, count: int) -> Archive:
    """`count` of the first `used` members of S_E, uniformly: leading axis `[count]`."""
    index = jax.random.randint(key, (count,), 0, used)
    return jax.tree.map(lambda x: x[index], archive)


def adapt(
    key: jax.Array,
    task: Task,
    bdq: BDQ,
    weights: jax.Array,
    starts: Archive,
    target: jax.Array,
    *,
    iterations: int = 10,
    delta: jax.Array | float = 0.1,
    shrink: jax.Array | float = 1.0,
) -> Phase2Result:
    """Adapt each of the `N` starts for `iterations` greedy steps in `target: [D]` (physical values).

    Pure: vmap over targets, seeds (weights and starts together) or starts. A return that is not finite never wins.
    """

    def one(key, start):
        return run_episode(
            key,
            task,
            lambda _, obs: bdq.greedy(weights, obs),
            gaussian(task.space, start.mean),
            start.policy,
            target,
            steps=iterations,
            delta=delta,
            shrink=shrink,
        )

    history = jax.vmap(one)(jax.random.split(key, starts.mean.shape[0]), starts)
    return best_of(history)


def best_visit(score: Any) -> tuple[jax.Array, jax.Array]:
    """`(start, visit)`, each `[]`, of the highest finite raw return of `score [N, I + 1]`; the first visit where none is finite."""
    finite = jnp.where(jnp.isfinite(score), score, -jnp.inf)
    start, visit = jnp.unravel_index(jnp.argmax(finite), finite.shape)
    return start, visit


def best_of(history: Episode) -> Phase2Result:
    """The visit with the highest finite raw return over all starts and iterations of `history: [N, I + 1, ...]`."""
    start, visit = best_visit(history.score)
    pick = lambda x: x[start, visit]
    policy = jax.tree.map(pick, history.policy)
    return Phase2Result(policy, pick(history.mean), pick(history.score), pick(history.reward), history)
