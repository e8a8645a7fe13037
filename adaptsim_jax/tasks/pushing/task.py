"""The bottle push (paper, section 5.2 and appendix A4): a NAF network chooses an open-loop push for
a goal on the table.

The task policy is trained in simulation (`simulator`) at parameters drawn from E, with goals
relabelled on stored pushes. At each adaptation iteration it is tried on two goals; these two
trajectories are all that the adaptation policy sees. In a simulated target the reward is the mean
over a fixed set of goals, `1 - distance / 0.2 m` and at least 0.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from adaptsim_jax import space as spaces
from adaptsim_jax.learners.naf import NAFConfig, make_naf
from adaptsim_jax.learners.naf_goals import GoalProblem, make_goal_learner
from adaptsim_jax.learners.naf_shared import SharedLearner, fold, move
from adaptsim_jax.space import Space
from adaptsim_jax.tasks.base import Task
from adaptsim_jax.tasks.pushing.config import (
    SETTINGS,
    PushingConfig,
    PushingPolicy,
    PushingTrajectory,
    checked,
    make_pushing_naf,
    naf_rates,
    pushing_space,
    wide_space,
)
from adaptsim_jax.tasks.pushing.corrections import nearer, refine, search, with_gaps
from adaptsim_jax.tasks.pushing.model import PARAMETERS
from adaptsim_jax.tasks.pushing.trial import (
    draw_goal,
    goal_input,
    goal_lattice,
    make_guide,
    make_simulator,
    measured,
    obs_dim,
    observed,
    observed_points,
    physical_action,
    push_reward,
    visit_goals,
)


def make_policy(
    config: PushingConfig = PushingConfig(),
) -> Callable[[PushingPolicy, Array], Array]:
    """`act(policy, goal [..., 2] m) -> [..., 2]`: the push for a goal, speed m/s and angle rad.
    Pure.
    """
    choose = make_choice(config)
    return lambda policy, goal: physical_action(choose(policy, goal))


def make_choice(config: PushingConfig) -> Callable[[PushingPolicy, Array], Array]:
    """The same with actions in [-1, 1]. A policy for no E in particular (UDR's) is not refined:
    there is no mean to try it at.
    """
    naf, space, guide = make_pushing_naf(config), pushing_space(config), make_guide(config)

    def end_of(push):
        return lambda at, a: push(space.physical(at), physical_action(a))[-1]

    end: Callable = end_of(make_simulator(config))
    hint: Any = None if guide is None else end_of(guide)

    def at_mean(at):
        return (lambda a: end(at, a), None if hint is None else lambda a: hint(at, a))

    def choose(policy, goal):
        action = naf.greedy(policy.weights, goal_input(goal))
        if config.refine == 0 or policy.at is None:
            return action
        goals, first = goal.reshape(-1, 2), action.reshape(-1, 2)
        if policy.told is None:
            push, steps = at_mean(policy.at)
            better = jax.vmap(lambda g, a: refine(push, g, a, config.refine, steps))(goals, first)
        else:

            def mended(push):
                return push and with_gaps(push, policy.told)

            nearest = map(mended, at_mean(nearer(end, policy.at, policy.told, hint)))
            mended_push, mended_steps = nearest
            better = search(
                mended_push, goals, first, config.refine, policy.told.used.any(), mended_steps
            )
        return better.reshape(action.shape)

    return choose


def make_pushing(config: PushingConfig = PushingConfig()) -> Task:
    """The push as a `Task`, simulated in the engine of `config`."""
    checked(config)
    simulate, space, naf = make_simulator(config), pushing_space(config), make_pushing_naf(config)
    how = config.tuning if config.pretrain else config.training
    learner = make_goal_learner(
        naf, _problem(space, simulate), how, naf_rates(config, config.pretrain)
    )
    block = how.block

    def train_many(keys, dists, policies, trials):
        rounds = (trials + block - 1) // block
        policies = jax.vmap(moved)(policies, dists.mean)
        if config.pretrain and not config.tune:
            return policies
        return policies._replace(
            weights=learner.train(keys, policies.weights, dists, rounds, jnp.max(rounds))
        )

    def train(key, dist, policy):
        dists, policies = jax.tree.map(lambda x: x[None], (dist, policy))
        trained = train_many(key[None], dists, policies, jnp.full(1, config.trials))
        return jax.tree.map(lambda x: x[0], trained)

    tests, refinement = (
        a or b for a, b in zip(config.rehearsal, (config.tests, config.refine), strict=True)
    )
    rehearsed = replace(config, tests=tests, refine=refinement)
    return Task(
        name="pushing",
        space=space,
        targets=space if config.targets == "omega" else wide_space(),
        obs_dim=obs_dim(config),
        settings=SETTINGS | _fitted(config),
        init_policy=lambda key: _blank(naf.init(key).online, config, space),
        train=train,
        rollout=_make_rollout(config),
        observe=lambda trajectory: observed(trajectory, config),
        score=lambda trajectory: trajectory.rewards.mean(),
        reference=lambda params: jnp.zeros(()),
        reward=lambda trajectory, reference: trajectory.tested,
        train_many=train_many,
        rehearse=None if rehearsed == config else _make_rollout(rehearsed),
        pretrain=_pretrain(config, space, simulate) if config.pretrain else None,
    )


def _fitted(config: PushingConfig) -> dict[str, dict[str, float]]:
    if config.fitted:
        return {"fitted": dict(zip(PARAMETERS, config.fitted, strict=True))}
    return {}


def _make_rollout(config: PushingConfig) -> Callable:
    """`(key, policy, params [D]) -> PushingTrajectory`: the visit's pushes, and the tests that its
    reward is the mean of.
    """
    grid, act, expect = goal_lattice(config.tests), make_policy(config), make_expectation(config)
    simulate = make_simulator(config)

    def rollout(key, policy, params):
        goals = visit_goals(key, config)
        push = jax.vmap(lambda a: simulate(params, a))
        # apart, so that the compiler leaves the test goals out where only the observation is asked
        # for
        tested = push_reward(push(act(policy, grid))[:, -1], grid).mean()
        return expect(measured(goals, push(act(policy, goals)), tested), policy)

    return rollout


def make_expectation(
    config: PushingConfig,
) -> Callable[[PushingTrajectory, PushingPolicy], PushingTrajectory]:
    """`expect(trajectory, policy)`: the trajectory of the policy's pushes, from any engine, with
    what they do at the mean of E.
    """
    if not config.show_gap:
        return lambda trajectory, policy: trajectory
    checked(config)
    simulate, space, act = make_simulator(config), pushing_space(config), make_policy(config)

    def expect(trajectory, policy):
        params = space.physical(policy.at)
        push = jax.vmap(lambda a: simulate(params, a))
        expected = observed_points(push(act(policy, trajectory.goals)))
        if policy.told is None:
            return trajectory._replace(expected=expected)
        # pushes of other actions than E's own: what E would have made them for (hindsight, as goals
        # are relabelled in training)
        return trajectory._replace(goals=expected[:, -1], expected=expected)

    return expect


def moved(policy: PushingPolicy, mean: Array) -> PushingPolicy:
    """The policy for another mean of E `[D]` (unit coordinates), before any training there. As it
    is, if it knows no other.
    """
    if policy.tilt is None or policy.at is None:
        return policy
    return policy._replace(
        weights=move(policy.weights, policy.tilt, 2.0 * (mean - policy.at)), at=mean
    )


def _blank(weights: Array, config: PushingConfig, space: Space) -> PushingPolicy:
    if not config.pretrain:
        return PushingPolicy(weights)
    return PushingPolicy(
        weights, jnp.zeros((space.dim, config.hidden[0])), jnp.full(space.dim, 0.5)
    )


def _pretrain(
    config: PushingConfig, space: Space, simulate: Callable
) -> Callable[[Array], PushingPolicy]:
    """`(key) -> policy` for all of Omega, at its centre; it was shown means in [-1, 1]."""
    wide = make_naf(NAFConfig(obs_dim=2 + space.dim, action_dim=2, hidden=config.hidden))

    def trial(key, u, action):
        return simulate(space.physical(u), physical_action(action))[-1]

    problem = GoalProblem(draw_goal, goal_input, trial, push_reward)
    learn = SharedLearner(
        wide, problem, space.sample, lambda u: 2.0 * u - 1.0, config.shared, naf_rates(config)
    ).train

    def pretrain(key):
        weights, tilt = fold(learn(key), 2, space.dim, config.hidden[0])
        return PushingPolicy(weights, tilt, jnp.full(space.dim, 0.5))

    return pretrain


def _problem(space: Space, simulate: Callable) -> GoalProblem:
    def trial(key, dist, action):
        params = space.physical(spaces.sample(key, dist))
        return simulate(params, physical_action(action))[-1]

    return GoalProblem(draw_goal, goal_input, trial, push_reward)
