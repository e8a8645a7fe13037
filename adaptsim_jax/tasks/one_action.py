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

    low, high: `[d]`, what actions are looked for between. tests: Rollouts that a policy is scored
        by; 1 where they know no chance.
    points: A side of the grid that the best action in a target is refined from. BadInput where
        policies are of another form.
    """
    actions = _Actions(task, np.asarray(low, np.float32), np.asarray(high, np.float32))
    dim = len(actions.low)
    lots = np.asarray(jax.vmap(jax.random.key_data)(jax.random.split(jax.random.key(0), tests)))
    return OneShot(
        task=task,
        tests=lots,
        trials=1,
        action_dim=dim,
        draw=jax.random.key_data,
        act=actions.act,
        explore=actions.explore,
        reward=actions.reward,
        trajectory=lambda contexts, outcomes: jax.tree.map(lambda x: x[0], outcomes[0]),
        train_uniform=lambda key: actions.best_over_space(key, (points,) * dim),
        tune=actions.best_tried,
        outputs=lambda outcome: jnp.atleast_1d(actions.reward(outcome, jnp.zeros(0))),
        worth=lambda observed, context: observed[0],
        world=_worlds(task, actions.tried),
        oracle=lambda world, params: best_actions(
            world, params, lots, actions.reward, (points,) * dim, rounds=6
        )[0],
        engine=OWN,
        simulator=f"rollouts of task {task.name} (JAX)",
        reward_unit="the task's reward, 1 at most",
        oracle_means=f"the best of a grid of {points} actions a side in the target, then six "
        f"rounds of neighbours",
    )


class _Actions:
    """Policies of `task` as actions `[d]` in [-1, 1], which span `low` to `high`."""

    def __init__(self, task: Task, low: np.ndarray, high: np.ndarray):
        self.task, self.low, self.high = task, low, high
        self.shape = _shape(task, low, high)

    def policy(self, action: Array) -> Any:
        """The policy that does `action [d]`."""
        return (self.low + 0.5 * (action + 1.0) * (self.high - self.low)).reshape(self.shape)

    def act(self, policy: Any, contexts: Array) -> Array:
        """Its action `[N, d]`, the same in all contexts."""
        share = (jnp.ravel(policy) - self.low) / (self.high - self.low)
        return jnp.tile(jnp.clip(2.0 * share - 1.0, -1.0, 1.0), (len(contexts), 1))

    def explore(self, key: Array, policy: Any, contexts: Array) -> Array:
        actions = self.act(policy, contexts)
        return jnp.clip(actions + NOISE * jax.random.normal(key, actions.shape), -1.0, 1.0)

    def tried(self, params: Array, context: Array, action: Array) -> Outcome:
        key = jax.random.wrap_key_data(context.astype(jnp.uint32))
        return self.task.rollout(key, self.policy(action), params), self.task.reference(params)

    def reward(self, outcome: Outcome, context: Array) -> Array:
        worth = self.task.reward(*outcome)
        return jnp.where(jnp.isfinite(worth), jnp.clip(worth, 0.0, 1.0), 0.0)

    def best_over_space(self, key: Array, points: tuple[int, ...]) -> Any:
        """The policy that is best on average over Omega."""
        space, grid = self.task.space, jnp.asarray(action_grid(points))
        keys = jax.random.split(key, DRAWS)
        params = jax.vmap(lambda k: space.physical(space.sample(k)))(keys)
        contexts = jax.vmap(jax.random.key_data)(keys)

        def worth(a):
            rewards = jax.vmap(lambda p, c: self.reward(self.tried(p, c, a), c))(params, contexts)
            return jnp.mean(rewards)

        return self.policy(grid[jnp.argmax(jax.lax.map(worth, grid))])

    def best_tried(
        self,
        key: Array,
        policy: Any,
        contexts: Array,
        actions: Array,
        outcomes: Outcome,
        used: Array,
    ) -> Any:
        """The best of what was tried."""
        rewards = jax.vmap(self.reward)(outcomes, contexts)
        worth = jnp.where(jnp.arange(len(actions)) < used, rewards, -1.0)
        return jnp.where(used > 0, self.policy(actions[jnp.argmax(worth)]), policy)


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


def _worlds(task: Task, tried: Callable[..., Outcome]) -> Callable[..., TargetWorld]:
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
