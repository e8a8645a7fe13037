"""The push as the baselines see it: one push for a goal, tried in any of the four engines. And what
is deployed after an adaptation in a simulated target, where `correct` is on: policies with the
pushes made before.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from adaptsim_jax.core import config as configs
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.learners.naf_goals import GoalProblem, Trials, make_goal_learner
from adaptsim_jax.tasks.base import Episode
from adaptsim_jax.tasks.one_shot import OneShot, TargetWorld, best_actions, naf_policies
from adaptsim_jax.tasks.pushing import model, task, trial
from adaptsim_jax.tasks.pushing.config import PushingConfig, PushingPolicy
from adaptsim_jax.tasks.pushing.corrections import PushRecord
from adaptsim_jax.tasks.pushing.engines import BACKENDS, make_backend
from adaptsim_jax.tasks.pushing.model import PushOptions
from adaptsim_jax.tasks.pushing.planar import TWINS
from adaptsim_jax.tasks.pushing.task import make_choice
from adaptsim_jax.tasks.pushing.trial import (
    POINTS,
    WORST,
    make_simulator,
    sector_goals,
    unseen,
    visit_goals,
)

SIMULATORS = {
    "planar": "planar model of the push (JAX)",
    "native": "MuJoCo scene (native)",
    "mjx": "MuJoCo scene (MJX)",
}
BOTTLES = {"paper": model.PAPER, "heavy": model.HEAVY, "light": model.LIGHT}


def make_pushing_one_shot(config: PushingConfig) -> OneShot:
    """The push with `config` for the comparison. Contexts are goals `[2]` m, outcomes the bottle's
    places `[6, 2]` m.
    """
    made, naf = task.make_pushing(config), task.make_pushing_naf(config)
    options = PushOptions(friction=config.friction, duration=config.duration)
    problem = _everywhere(made.space, task.make_simulator(config))
    learner = make_goal_learner(naf, problem, config.training, task.naf_rates(config))

    def trials(goals, actions, points):
        return Trials(goals, actions, points[:, -1])

    policies: Table = naf_policies(
        naf, learner, config.trials, config.training, PushingPolicy, task.goal_input, trials
    )
    policies["act"] = task.make_choice(config)

    tests = np.asarray(task.goal_lattice(config.tests))
    return OneShot(
        task=made,
        tests=tests,
        trials=config.trajectories,
        action_dim=2,
        draw=task.draw_goal,
        reward=_reward,
        trajectory=lambda goals, points: trial.of_points(goals, points),
        **policies,
        outputs=lambda points: task.goal_input(points[-1]),
        worth=lambda observed, goal: jnp.maximum(
            0.0, 1.0 - jnp.linalg.norm(unseen(observed) - goal) / WORST
        ),
        world=partial(_world, config, options),
        oracle=lambda world, params: _oracle(world, params, tests),
        engine=config.simulator,
        simulator=SIMULATORS[config.simulator],
        reward_unit=f"1 - distance / {WORST} m, at least 0, mean over {config.tests} goals",
        oracle_means="the best of a grid of 161 speeds x 31 angles for each goal in the target "
        "(in other engines than planar 17 x 9, then three rounds of neighbours)",
        aim=make_aims(config),
        expect=task.make_expectation(config),
        remember=_remember if config.correct else None,
        probe=(lambda policy: policy) if config.visits == "deployed" else None,
    )


def _world(
    config: PushingConfig, options: PushOptions, backend: str, /, **settings: Any
) -> TargetWorld:
    """A target in `backend`; the planar model is the one of `config`."""
    own: Table = {}
    if backend == "planar":
        own = {"coefficients": config.coefficients, "lacking": asdict(config.mended)}
    return pushing_world(backend, options, **(own | settings))


def _oracle(world: TargetWorld, params: np.ndarray, tests: np.ndarray) -> np.ndarray:
    """`[G]` rewards of the best pushes for the goals `tests [G, 2]` m."""
    points, rounds = ((161, 31), 0) if world.name == "planar" else ((17, 9), 3)
    return best_actions(world, params, tests, _reward, points, shared=True, rounds=rounds)[0]


def pushing_world(
    backend: str, options: PushOptions = model.PAPER, /, bottle: str = "paper", **settings: Any
) -> TargetWorld:
    """The push in `backend` (planar, native, mjx, drake). Pushes that fail give not-a-number, hence
    reward 0.

    bottle: `heavy` and `light` are the stand-ins whose mass and inertia no parameter models (not in
    planar). coefficients: Of planar, `drake` for its twin of Drake. Others are the engine's own,
    see `make_backend`.
    """
    if bottle not in list(BOTTLES):  # a list, for a table has no hash
        raise BadInput(f"pushing, bottle = {bottle!r}: unknown; use one of {', '.join(BOTTLES)}")
    for name in settings:
        configs.pick(
            f"setting of {backend}",
            name,
            ("bottle", *BACKENDS.named(backend, "backend").settings._fields),
        )
    if isinstance(twin := settings.get("coefficients"), str):
        settings["coefficients"] = TWINS[configs.pick("coefficients", twin, TWINS)]
    body = BOTTLES[bottle]
    chosen = PushOptions(options.friction, options.duration, body.mass, body.com, body.inertia)
    simulate = make_backend(backend, chosen, **settings).simulate
    rows = trial.observed_rows(model.rows(chosen))

    def run(params, goals, actions):
        physical = np.asarray(task.physical_action(jnp.asarray(actions)))
        found = simulate(np.asarray(params), physical, np.tile(model.START, (len(physical), 1)))
        points = np.asarray(found.state[:, rows, :2], np.float32)
        return np.where((found.code == model.FINE)[:, None, None], points, np.nan), np.asarray(
            found.code
        )

    return TargetWorld(backend, run, dict(model.MESSAGES))


def _reward(points: Array, goal: Array) -> Array:
    return task.push_reward(points[-1], goal)


def _remember(policy: PushingPolicy, actions: Array, points: Array, used: Array) -> PushingPolicy:
    places = points[:, -1]
    return policy._replace(told=PushRecord(actions, places, used & jnp.isfinite(places).all(-1)))


def _everywhere(space: Any, simulate: Any) -> GoalProblem:
    """Pushes at parameters spread uniformly over Omega, a new draw for each."""

    def trial(key, context, action):
        params = space.physical(space.sample(key))
        return simulate(params, task.physical_action(action))[-1]

    return GoalProblem(task.draw_goal, task.goal_input, trial, task.push_reward)


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
    history: Episode, target: Array, config: PushingConfig
) -> tuple[PushingPolicy, PushRecord]:
    """The policies `[N, I + 1]` of `history [N, I + 1]` in `target [D]` (physical), each told the
    pushes that all N starts made before its iteration; and all of these pushes. Those that failed
    (their places are not finite) do not count.

    Goals are read back from what was observed, so they must be shown. Pure.
    """
    N, turns = history.mean.shape[:2]
    choose, end = task.make_choice(config), _end(target, config)

    def pushed(policy, obs):
        observed = obs[history.mean.shape[-1] :].reshape(
            config.trajectories, -1, 2
        )  # behind the mean of E: places, the goal, gaps
        actions = choose(
            policy, unseen(observed[:, POINTS if config.observation == "points" else 1])
        )
        return actions, jax.vmap(end)(task.physical_action(actions))

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


def tested(policies: PushingPolicy, target: Array, config: PushingConfig) -> Array:
    """Mean rewards `[N]` of `policies [N]` over the test goals in `target [D]` (physical). Pure."""
    grid, act, end = (
        task.goal_lattice(config.tests),
        task.make_policy(config),
        _end(target, config),
    )
    return jax.lax.map(
        lambda policy: task.push_reward(jax.vmap(end)(act(policy, grid)), grid).mean(), policies
    )


def _end(target: Array, config: PushingConfig) -> Callable[[Array], Array]:
    simulate = make_simulator(config)
    return lambda action: simulate(target, action)[-1]


DRAWN = 8  # goals in each part of the sector that one is taken of


def make_aims(config: PushingConfig) -> Callable[[Array, PushingPolicy], Array]:
    """`aims(key, policy) -> [trajectories, 2]` m, the goals of an iteration's pushes in a target.
    Pure.

    Where visits are E's own they are `visit_goals`. Otherwise one in each part of the sector,
    anywhere in it. Of some that are drawn it is the one whose action lies farthest from all pushes
    made. So a few pushes cover what will be asked for.
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
