"""Of a task whose policy is its one action, what the baselines of `adaptsim compare` need
(`one_shot.py`).

For small tasks: the action is tried once a visit, in the task's own simulator. What is deployed
sees nothing of a trial beforehand, so a context is the trial's luck alone: the key of its rollout.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.base import Task
from adaptsim_jax.tasks.one_shot import OneShot, TargetWorld, action_grid, best_actions

OWN = "own"  # the only engine: the task's rollouts
NOISE = 0.1  # of half the range of actions: exploration
DRAWS = 64  # of Omega, that one policy for all of it is chosen by

Array = Any
Outcome = tuple[Any, Any]  # trajectory, and what rewards in that target are scaled with


def one_action(
    task: Task, low: Sequence[float], high: Sequence[float], *, tests: int = 1, points: int = 41
) -> OneShot:
    """The comparison's view of `task`, whose policies are one array of `d` numbers: the action, in
    its own units.

    low, high: `[d]`, what actions are looked for between. tests: rollouts that a policy is scored
        by; 1 where they know no chance.
    points: a side of the grid that the best action in a target is refined from. BadInput where
        policies are of another form.
    """
    low_, high_ = np.asarray(low, np.float32), np.asarray(high, np.float32)
    shape = _shape(task, low_, high_)

    def policy_of(action):
        return (low_ + 0.5 * (action + 1.0) * (high_ - low_)).reshape(shape)

    def action_of(policy):
        return jnp.clip(2.0 * (jnp.ravel(policy) - low_) / (high_ - low_) - 1.0, -1.0, 1.0)

    def every(policy, contexts):
        return jnp.tile(action_of(policy), (len(contexts), 1))

    def tried(params: Array, context: Array, action: Array) -> Outcome:
        key = jax.random.wrap_key_data(context.astype(jnp.uint32))
        return task.rollout(key, policy_of(action), params), task.reference(params)

    def explore(key: Array, policy: Any, contexts: Array) -> Array:
        actions = every(policy, contexts)
        return jnp.clip(actions + NOISE * jax.random.normal(key, actions.shape), -1.0, 1.0)

    def reward(outcome: Outcome, context: Array) -> Array:
        worth = task.reward(*outcome)
        return jnp.where(jnp.isfinite(worth), jnp.clip(worth, 0.0, 1.0), 0.0)

    def train_uniform(key: Array) -> Any:
        space, grid = task.space, jnp.asarray(action_grid((points,) * len(low_)))
        keys = jax.random.split(key, DRAWS)
        params = jax.vmap(lambda k: space.physical(space.sample(k)))(keys)
        contexts = jax.vmap(jax.random.key_data)(keys)

        def worth(a):
            return jnp.mean(jax.vmap(lambda p, c: reward(tried(p, c, a), c))(params, contexts))

        return policy_of(grid[jnp.argmax(jax.lax.map(worth, grid))])

    def tune(
        key: Array, policy: Any, contexts: Array, actions: Array, outcomes: Outcome, used: Array
    ) -> Any:
        """The best of what was tried."""
        worth = jnp.where(
            jnp.arange(len(actions)) < used, jax.vmap(reward)(outcomes, contexts), -1.0
        )
        return jnp.where(used > 0, policy_of(actions[jnp.argmax(worth)]), policy)

    lots = np.asarray(jax.vmap(jax.random.key_data)(jax.random.split(jax.random.key(0), tests)))
    return OneShot(
        task=task,
        tests=lots,
        trials=1,
        action_dim=len(low_),
        draw=jax.random.key_data,
        act=every,
        explore=explore,
        reward=reward,
        trajectory=lambda contexts, outcomes: jax.tree.map(lambda x: x[0], outcomes[0]),
        train_uniform=train_uniform,
        tune=tune,
        inputs=lambda context, action: action,
        outputs=lambda outcome: jnp.atleast_1d(reward(outcome, jnp.zeros(0))),
        worth=lambda observed, context: observed[0],
        world=_worlds(task, tried, reward),
        oracle=lambda world, params: best_actions(
            world, params, lots, reward, (points,) * len(low_), rounds=6
        )[0],
        engine=OWN,
        simulator=f"rollouts of task {task.name} (JAX)",
        reward_unit="the task's reward, 1 at most",
        oracle_means=f"the best of a grid of {points} actions a side in the target, then six "
        f"rounds of neighbours",
    )


def _shape(task: Task, low: np.ndarray, high: np.ndarray) -> tuple[int, ...]:
    """Of a policy. BadInput where it is no array of as many numbers as there are bounds, or the
    bounds are none.
    """
    leaves = jax.tree.leaves(jax.eval_shape(task.init_policy, jax.random.key(0)))
    if low.ndim != 1 or low.shape != high.shape or not np.all(low < high):
        raise BadInput(
            f"task {task.name}: low = {low.tolist()} and high = {high.tolist()} bound no actions"
        )
    if len(leaves) != 1 or leaves[0].size != len(low):
        sizes = ", ".join(str(x.shape) for x in leaves)
        raise BadInput(
            f"task {task.name}: its policy has arrays of shapes {sizes} and is not one action of "
            f"{len(low)} numbers; give low and high for each, or a `OneShot` of its own"
        )
    return leaves[0].shape


def _worlds(
    task: Task, tried: Callable[..., Outcome], reward: Callable[[Outcome, Array], Array]
) -> Callable[..., TargetWorld]:
    """The task's own simulator as the target; BadInput for any other."""
    rollouts = jax.jit(jax.vmap(tried))
    valued = jax.jit(jax.vmap(lambda outcome: task.reward(*outcome)))

    def run(params: Array, contexts: Array, actions: Array) -> tuple[Outcome, np.ndarray]:
        outcomes = rollouts(*(jnp.asarray(x) for x in (params, contexts, actions)))
        return outcomes, np.asarray(~jnp.isfinite(valued(outcomes)), int)

    def world(backend: str, /, **settings: Any) -> TargetWorld:
        if backend != OWN or settings:
            asked = ", ".join([backend, *settings])
            raise BadInput(
                f"task {task.name} has no engine beside its own simulator ({asked}); leave target "
                "out"
            )
        return TargetWorld(OWN, run, {1: "its reward is not finite"})

    return world
