"""The push as the baselines see it: one push for a goal, tried in any of the four engines."""

from dataclasses import asdict
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core import config as configs
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.learners.naf_goals import GoalProblem, Trials, make_goal_learner
from adaptsim_jax.tasks.one_shot import OneShot, TargetWorld, best_actions
from adaptsim_jax.tasks.one_shot_naf import naf_policies
from adaptsim_jax.tasks.pushing import model, task
from adaptsim_jax.tasks.pushing.corrections import PushRecord
from adaptsim_jax.tasks.pushing.deployed import make_aims
from adaptsim_jax.tasks.pushing.engines import BACKENDS, make_backend
from adaptsim_jax.tasks.pushing.goals import WORST, unseen
from adaptsim_jax.tasks.pushing.model import PushOptions
from adaptsim_jax.tasks.pushing.simulator import TWINS
from adaptsim_jax.tasks.pushing.task import PushingConfig, PushingPolicy

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
    space = made.space
    learner = make_goal_learner(
        naf,
        _everywhere(space, task.make_simulator(config)),
        config.training,
        task.naf_rates(config),
    )

    def trials(goals, actions, points):
        return Trials(goals, actions, points[:, -1])

    policies: dict[str, Any] = naf_policies(
        naf, learner, config.trials, config.training, PushingPolicy, task.goal_input, trials
    )
    policies["act"] = task.make_choice(config)

    def world(backend, /, **settings):
        if backend == "planar":
            own = {"coefficients": config.coefficients, "lacking": asdict(config.mended)}
        else:
            own = {}
        return pushing_world(backend, options, **(own | settings))

    def oracle(world, params):
        if world.name == "planar":
            points, zooms = ((161, 31), 0)
        else:
            points, zooms = ((17, 9), 3)
        return best_actions(world, params, tests, _reward, points, shared=True, rounds=zooms)[0]

    tests = np.asarray(task.goal_lattice(config.tests))
    return OneShot(
        task=made,
        tests=tests,
        trials=config.trajectories,
        action_dim=2,
        draw=task.draw_goal,
        reward=_reward,
        trajectory=lambda goals, points: task.of_points(goals, points),
        **policies,
        inputs=lambda goal, action: action,
        outputs=lambda points: task.goal_input(points[-1]),
        worth=lambda observed, goal: jnp.maximum(
            0.0, 1.0 - jnp.linalg.norm(unseen(observed) - goal) / WORST
        ),
        world=world,
        oracle=oracle,
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


def pushing_world(
    backend: str, options: PushOptions = model.PAPER, /, bottle: str = "paper", **settings: Any
) -> TargetWorld:
    """The push in `backend` (planar, native, mjx, drake). Pushes that fail give not-a-number, hence
    reward 0.

    bottle: `heavy` and `light` are the stand-ins whose mass and inertia no parameter models (not in
    planar). coefficients: of planar, `drake` for its twin of Drake. Others are the engine's own,
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
    rows = task.observed_rows(model.rows(chosen))

    def run(params, goals, actions):
        physical = np.asarray(task.physical_action(jnp.asarray(actions)))
        found = simulate(np.asarray(params), physical, np.tile(model.START, (len(physical), 1)))
        points = np.asarray(found.state[:, rows, :2], np.float32)
        return np.where((found.code == model.FINE)[:, None, None], points, np.nan), np.asarray(
            found.code
        )

    return TargetWorld(backend, run, dict(model.MESSAGES))


def _reward(points: jax.Array, goal: jax.Array) -> jax.Array:
    return task.push_reward(points[-1], goal)


def _remember(
    policy: PushingPolicy, actions: jax.Array, points: jax.Array, used: jax.Array
) -> PushingPolicy:
    places = points[:, -1]
    return policy._replace(told=PushRecord(actions, places, used & jnp.isfinite(places).all(-1)))


def _everywhere(space: Any, simulate: Any) -> GoalProblem:
    """Pushes at parameters spread uniformly over Omega, a new draw for each."""

    def trial(key, context, action):
        params = space.physical(space.sample(key))
        return simulate(params, task.physical_action(action))[-1]

    return GoalProblem(task.draw_goal, task.goal_input, trial, task.push_reward)
