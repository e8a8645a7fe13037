"""Scooping as the baselines see it: one scoop of one piece, tried in either engine."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from adaptsim_jax.core import config as configs
from adaptsim_jax.core.config import Table
from adaptsim_jax.learners.naf_goals import Trials, make_goal_learner
from adaptsim_jax.tasks.one_shot import OneShot, TargetWorld, action_grid, naf_policies
from adaptsim_jax.tasks.scooping import engines as backends
from adaptsim_jax.tasks.scooping import model, task
from adaptsim_jax.tasks.scooping.config import ScoopingConfig, ScoopingPolicy, ScoopingTrajectory
from adaptsim_jax.tasks.scooping.corrections import ScoopRecord
from adaptsim_jax.tasks.scooping.deployed import make_choice, make_probe
from adaptsim_jax.tasks.scooping.model import Numerics, ScoopOptions

GRID = (9, 5, 5)  # pitches, rates and distances that the oracle tries
FINALISTS = 8  # and how many of them it tries in all test contexts
HEIGHT_UNIT = 0.02  # m
UDR_CHECKS = 256  # pieces of Omega that the best of UDR's policies is chosen by


def make_scooping_one_shot(config: ScoopingConfig) -> OneShot:
    """Scooping with `config` for the comparison. Contexts are `scooping.CONTEXT`, outcomes `[9, 2]`
    as `make_trial`'s.

    Targets are worlds, whose trials an engine makes; what methods simulate besides (SysID's data)
    they rehearse in the bank.
    """
    made, naf = task.make_scooping(config), task.make_scooping_naf(config)

    def anywhere(key, context):
        return made.space.physical(made.space.sample(key))

    problem = task.training_problem(config, anywhere, UDR_CHECKS if config.checks else 0)
    learner = make_goal_learner(naf, problem, config.training, task.naf_rates(config))

    def trials(contexts, actions, outcomes):
        return Trials(contexts[:, :2], actions, task.success(outcomes)[:, None])

    policies: Table = naf_policies(
        naf, learner, config.trials, config.training, ScoopingPolicy, task.place_input, trials
    )
    policies["act"] = make_choice(config)
    tests, fresh = np.split(task.test_contexts(config.tests + config.fresh), [config.tests])
    probes = config.correct and config.trajectories > 1
    in_mjx = config.simulator == "mjx"
    score = _own_score if probes else made.score
    return OneShot(
        task=replace(made, rollout=made.rehearse or made.rollout, score=score),
        tests=tests,
        fresh=fresh if config.fresh else None,
        trials=config.trajectories,
        action_dim=3,
        draw=task.draw_context,
        reward=lambda outcome, context: task.success(outcome),
        trajectory=lambda contexts, outcomes: task.measured(contexts, outcomes, config.camera),
        **policies,
        outputs=lambda outcome: jnp.stack(
            [outcome[-1, 0], jnp.clip(outcome[-1, 1] / HEIGHT_UNIT, -2.0, 2.0)]
        ),
        worth=lambda observed, context: observed[0],
        world=lambda backend, /, **settings: scooping_world(
            backend, task.checked(config), config.numerics, **settings
        ),
        oracle=lambda world, params: best_shared_action(world, params, tests),
        engine="mjx" if in_mjx else "hydro",
        simulator="MuJoCo scene (MJX)" if in_mjx else "hydroelastic engine (JAX)",
        reward_unit=f"share of pieces on the spatula at the end, over {config.tests} places and "
        f"execution errors",
        oracle_means=f"the best single action of a grid of {' x '.join(map(str, GRID))} in the "
        f"target: all are tried in one test "
        f"context, the {FINALISTS} that are best there and around in all",
        remember=_remember if config.correct else None,
        probe=make_probe(config) if probes else None,
    )


def scooping_world(
    backend: str,
    options: ScoopOptions,
    numerics: Numerics = Numerics(),  # noqa: B008
    /,
    **settings: Any,
) -> TargetWorld:
    """Scooping in `backend` (`backends.BACKENDS`). Trials that fail give not-a-number, hence reward
    0.
    """
    if backend == "hydro":
        own = {"numerics": configs.to_table(numerics)}
    else:
        own = {}
    simulate = backends.make_backend(backend, options, **configs.over(own, settings)).simulate
    rows = np.maximum(np.round(np.array(model.OBSERVED_AT) / model.ROW).astype(int) - 1, 0)
    execute = jax.jit(jax.vmap(lambda a, c: task.executed(a, c, options)))

    def run(params, contexts, actions):
        done = np.asarray(execute(jnp.asarray(actions), jnp.asarray(contexts)))
        found = simulate(np.asarray(params), done, np.zeros((len(done), 2)))
        lies, above = model.outcome(found.state)
        places = found.state[:, rows, :2].copy()
        places[:, 0] = 0.0  # seen before it moves
        outcomes = np.concatenate([places, np.stack([lies, above], -1)[:, None]], 1).astype(
            np.float32
        )
        lost = np.isin(found.code, (model.DIVERGED, model.UNFIT))
        return np.where(lost[:, None, None], np.nan, outcomes), np.where(lost, found.code, 0)

    return TargetWorld(backend, run, dict(model.MESSAGES))


def best_shared_action(world: TargetWorld, params: np.ndarray, tests: np.ndarray) -> np.ndarray:
    """`[G]` rewards of the best single action in `params [D]`: nobody knows a trial's errors when
    choosing.

    Actions of the grid are tried in one context and smoothed over their neighbours; the finalists
    are tried in all.
    """
    grid = action_grid(GRID)
    exact = tests[:1] * np.array([1, 1, 0, 0, 1], np.float32)
    won = _rewards(world, params, np.tile(exact, (len(grid), 1)), grid)
    spacing = 2.0 / (np.array(GRID) - 1)
    near = np.exp(-0.5 * (((grid[:, None] - grid[None]) / spacing) ** 2).sum(-1))
    chosen = grid[np.argsort(-(near @ won) / near.sum(1), kind="stable")[:FINALISTS]]
    pairs = np.repeat(chosen, len(tests), 0)
    rewards = _rewards(world, params, np.tile(tests, (len(chosen), 1)), pairs).reshape(
        len(chosen), -1
    )
    return rewards[rewards.mean(1).argmax()]


def _own_score(trajectory: ScoopingTrajectory) -> Array:
    """The return of the policy's own scoops: the last was a probe's."""
    return trajectory.success[:-1].mean()


def _remember(
    policy: ScoopingPolicy, actions: Array, outcomes: Array, used: Array
) -> ScoopingPolicy:
    return policy._replace(told=ScoopRecord(actions, task.success(outcomes), used))


def _rewards(
    world: TargetWorld, params: np.ndarray, contexts: np.ndarray, actions: np.ndarray
) -> np.ndarray:
    outcomes, _ = world.run(np.tile(params, (len(actions), 1)), contexts, actions)
    return np.asarray(task.success(jnp.asarray(outcomes)))
