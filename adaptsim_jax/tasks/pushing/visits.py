"""Which goals an iteration's pushes are made for, where they are made to learn what is deployed
(`PushingConfig.visits`).
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from adaptsim_jax.tasks.pushing.config import PushingConfig, PushingPolicy
from adaptsim_jax.tasks.pushing.goals import sector_goals, visit_goals
from adaptsim_jax.tasks.pushing.task import make_choice

DRAWN = 8  # goals in each part of the sector that one is taken of


def make_aims(config: PushingConfig) -> Callable[[jax.Array, PushingPolicy], jax.Array]:
    """`aims(key, policy) -> [trajectories, 2]` m, the goals of an iteration's pushes in a target.
    Pure.

    Where visits are E's own they are `visit_goals`. Otherwise one in each part of the sector,
    anywhere in it: of some that are drawn the one whose action lies farthest from all pushes made,
    so that a few pushes cover what will be asked for.
    """
    if config.visits == "own":
        return lambda key, policy: visit_goals(key, config)
    choose, parts = make_choice(config), config.trajectories

    def aims(key, policy):
        if policy.told is None:
            return sector_goals(key, parts, 1)[:, 0]
        goals = sector_goals(key, parts, DRAWN)
        actions = choose(policy, goals)
        made, used, taken = policy.told.actions, policy.told.used, []
        for part in range(parts):
            apart = jnp.sum((actions[part][:, None] - made[None]) ** 2, -1)
            best = jnp.argmax(jnp.min(jnp.where(used[None], apart, jnp.inf), 1))
            made, used = jnp.concatenate([made, actions[part][best][None]]), jnp.append(used, True)
            taken.append(goals[part][best])
        return jnp.stack(taken)

    return aims
