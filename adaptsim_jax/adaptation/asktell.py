"""Phase 2 with a real robot: ask which policy to run, tell what was measured (paper, Algorithm 2).

The state is a pytree of arrays, so that it can be kept on disk between trials. Told simulated
trajectories, this visits the same distributions as `phase2.adapt`.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from adaptsim_jax import space as spaces
from adaptsim_jax.adaptation.phase1 import Archive
from adaptsim_jax.adaptation.phase2 import best_visit, smoothed
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.learners.bdq import BDQ
from adaptsim_jax.space import gaussian
from adaptsim_jax.tasks.base import Task


class Tried(NamedTuple):
    """All trials of a session: mean `[T, D]` unit coordinates, policy `[T, ...]`, raw return score
    `[T]`, NaN of those to come.
    """

    mean: jax.Array
    policy: Any
    score: jax.Array


class AskState(NamedTuple):
    """What the next call needs.

    told: `[]` int32, trials so far; mean: `[D]` unit coordinates and policy: what to run now;
    starts: `[N, ...]`; best_*: of the trial with the highest raw return so far, or where the task
        has its doubts of single returns of that with the highest expected one (`phase2.smoothed`);
        tried: what that is chosen from, else empty.
    """

    key: jax.Array
    told: jax.Array
    mean: jax.Array
    policy: Any
    starts: Archive
    best_score: jax.Array
    best_mean: jax.Array
    best_policy: Any
    tried: Tried | tuple[()] = ()


class TellInfo(NamedTuple):
    """What came of a trial: raw return `score: []`, greedy `action: [D]`, `best: []` if the best so
    far.
    """

    score: jax.Array
    action: jax.Array
    best: jax.Array


class AskTell(NamedTuple):
    """`init(key, starts) -> state`; `tell(state, trajectory) -> (state, info)`; `trials(state) ->
    int`.

    `skip(state) -> state`: the robot cannot run this policy, so its start is given up and the next
    one is asked for.
    """

    init: Callable[[jax.Array, Archive], AskState]
    tell: Callable[[AskState, Any], tuple[AskState, TellInfo]]
    trials: Callable[[AskState], int]
    skip: Callable[[AskState], AskState]


def make_ask_tell(
    task: Task,
    bdq: BDQ,
    weights: Any,
    *,
    iterations: int = 10,
    delta: float = 0.1,
    shrink: float = 1.0,
) -> AskTell:
    """Greedy adaptation of each start for `iterations` steps: `N (iterations + 1)` trials in
    all.
    """
    if iterations < 1:
        raise BadInput(f"iterations = {iterations}: nothing would be adapted; use at least 1")
    train = jax.jit(lambda key, mean, policy: task.train(key, gaussian(task.space, mean), policy))

    def init(key, starts):
        mean, policy = jax.tree.map(lambda x: x[0], starts)
        policy = train(jax.random.fold_in(key, 0), mean, policy)
        count = starts.mean.shape[0] * (iterations + 1)

        def room(x):
            return jnp.zeros((count, *jnp.shape(x)), jnp.result_type(x))

        if task.doubt:
            tried = Tried(room(mean), jax.tree.map(room, policy), jnp.full(count, jnp.nan))
        else:
            tried = ()
        none = -jnp.inf * jnp.ones(())
        return AskState(
            key, jnp.zeros((), jnp.int32), mean, policy, starts, none, mean, policy, tried
        )

    def tell(state, trajectory):
        score = task.score(trajectory)
        best, better, tried = _best(state, score)
        obs = jnp.concatenate([2.0 * state.mean - 1.0, task.observe(trajectory)])
        action = bdq.greedy(weights, obs)
        told = state.told + 1
        mean, policy = _next(state, action, int(told))
        policy = train(jax.random.fold_in(state.key, told), mean, policy)
        return AskState(state.key, told, mean, policy, state.starts, *best, tried), TellInfo(
            score, action, better
        )

    def _best(state, score) -> tuple[tuple[Any, Any, Any], Any, Any]:
        """(Return, mean and policy) of the best trial, whether that is this one, and all trials."""
        own, before = (
            (score, state.mean, state.policy),
            (state.best_score, state.best_mean, state.best_policy),
        )
        if not task.doubt:
            better = jnp.isfinite(score) & (score > state.best_score)
            return (
                jax.tree.map(lambda new, old: jnp.where(better, new, old), own, before),
                better,
                (),
            )
        new = Tried(state.mean, state.policy, score)
        tried = jax.tree.map(lambda every, one: every.at[state.told].set(one), state.tried, new)
        best = best_visit(smoothed(tried.mean, tried.score, task.doubt)[None])[1]
        some = jnp.any(jnp.isfinite(tried.score))
        picked = jax.tree.map(lambda x: x[best], (tried.score, tried.mean, tried.policy))
        kept = jax.tree.map(lambda new, old: jnp.where(some, new, old), picked, before)
        return kept, some & (best == state.told), tried

    def skip(state):
        told = (int(state.told) // (iterations + 1) + 1) * (iterations + 1)
        mean, policy = _next(state, None, told)
        policy = train(jax.random.fold_in(state.key, told), mean, policy)
        return state._replace(told=jnp.asarray(told, jnp.int32), mean=mean, policy=policy)

    def _next(state, action, told):
        start, iteration = divmod(told, iterations + 1)
        if iteration == 0:  # the next start, or the last one again once all is told
            index = min(start, trials(state) // (iterations + 1) - 1)
            return jax.tree.map(lambda x: x[index], tuple(state.starts))
        dist = spaces.step(
            task.space, gaussian(task.space, state.mean), action, delta * shrink ** (iteration - 1)
        )
        return dist.mean, state.policy

    def trials(state):
        return state.starts.mean.shape[0] * (iterations + 1)

    return AskTell(init, tell, trials, skip)
