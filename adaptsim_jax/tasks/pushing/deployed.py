"""What visits push at, and what is deployed after an adaptation in a simulated target, where
`correct` is on: policies with the pushes made before.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from adaptsim_jax.tasks.base import Episode
from adaptsim_jax.tasks.pushing import task as pushing
from adaptsim_jax.tasks.pushing.config import PushingConfig, PushingPolicy
from adaptsim_jax.tasks.pushing.corrections import PushRecord
from adaptsim_jax.tasks.pushing.goals import sector_goals, unseen, visit_goals
from adaptsim_jax.tasks.pushing.simulator import make_simulator
from adaptsim_jax.tasks.pushing.task import make_choice


def as_deployed(config: PushingConfig, result: Any, target: Any) -> Any:
    """`result` of Phase 2 with its policies and rewards as they are deployed: corrected by the
    pushes made before, and the best visit's policy by all that were made, where the task does that
    (`correct`).
    """
    if not config.correct or not config.show_goal:
        return result
    aim, history = jnp.asarray(target, jnp.float32), result.history
    policies, every = jax.jit(lambda h: deployed(h, aim, config))(history)
    flat = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), policies)
    best = jax.tree.map(lambda x: x[None], result.policy._replace(told=every))
    together = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), flat, best)
    rewards = jax.jit(lambda p: tested(p, aim, config))(together)
    history = history._replace(policy=policies, reward=rewards[:-1].reshape(history.reward.shape))
    return result._replace(
        policy=result.policy._replace(told=every), reward=rewards[-1], history=history
    )


def deployed(
    history: Episode, target: jax.Array, config: PushingConfig
) -> tuple[PushingPolicy, PushRecord]:
    """The policies `[N, I + 1]` of `history [N, I + 1]` in `target [D]` (physical), each told the
    pushes that all N starts made before its iteration; and all of these pushes. Those that failed
    (their places are not finite) do not count.

    Goals are read back from what was observed, so they must be shown. Pure.
    """
    N, turns = history.mean.shape[:2]
    choose, end = pushing.make_choice(config), _end(target, config)

    def pushed(policy, obs):
        observed = obs[history.mean.shape[-1] :].reshape(
            config.trajectories, -1, 2
        )  # behind the mean of E: places, the goal, gaps
        actions = choose(
            policy, unseen(observed[:, pushing.POINTS if config.observation == "points" else 1])
        )
        return actions, jax.vmap(end)(pushing.physical_action(actions))

    actions, places = jax.vmap(jax.vmap(pushed))(history.policy, history.obs)
    made = jnp.broadcast_to(
        jnp.arange(turns)[None, :, None], (N, turns, config.trajectories)
    ).reshape(-1)
    places = places.reshape(-1, 2)
    every = PushRecord(actions.reshape(-1, 2), places, jnp.isfinite(places).all(-1))

    def at(i):
        return every._replace(used=every.used & (made < i))

    trials = jax.vmap(lambda _: jax.vmap(at)(jnp.arange(turns)))(jnp.arange(N))
    return history.policy._replace(told=trials), every


def tested(policies: PushingPolicy, target: jax.Array, config: PushingConfig) -> jax.Array:
    """Mean rewards `[N]` of `policies [N]` over the test goals in `target [D]` (physical). Pure."""
    grid, act, end = (
        pushing.goal_lattice(config.tests),
        pushing.make_policy(config),
        _end(target, config),
    )
    return jax.lax.map(
        lambda policy: pushing.push_reward(jax.vmap(end)(act(policy, grid)), grid).mean(), policies
    )


def _end(target: jax.Array, config: PushingConfig) -> Callable[[jax.Array], jax.Array]:
    simulate = make_simulator(config)
    return lambda action: simulate(target, action)[-1]


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
            distance = jnp.sum((actions[part][:, None] - made[None]) ** 2, -1)
            best = jnp.argmax(jnp.min(jnp.where(used[None], distance, jnp.inf), 1))
            made, used = jnp.concatenate([made, actions[part][best][None]]), jnp.append(used, True)
            taken.append(goals[part][best])
        return jnp.stack(taken)

    return aims
