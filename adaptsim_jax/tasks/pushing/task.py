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
import numpy as np

from adaptsim_jax import space as spaces
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.learners.naf import NAF, NAFConfig, NAFHyper, make_naf
from adaptsim_jax.learners.naf_goals import GoalProblem, make_goal_learner
from adaptsim_jax.learners.naf_shared import SharedLearner, fold, move
from adaptsim_jax.space import Space
from adaptsim_jax.tasks.base import Task
from adaptsim_jax.tasks.pushing import planar
from adaptsim_jax.tasks.pushing.config import (
    SETTINGS,
    PushingConfig,
    PushingPolicy,
    PushingTrajectory,
    pushing_space,
    wide_space,
)
from adaptsim_jax.tasks.pushing.corrections import nearer, refine, search, with_gaps
from adaptsim_jax.tasks.pushing.goals import (
    draw_goal,
    goal_input,
    goal_lattice,
    physical_action,
    push_reward,
    visit_goals,
)
from adaptsim_jax.tasks.pushing.model import PARAMETERS, PushOptions
from adaptsim_jax.tasks.pushing.simulator import POINTS, make_guide, make_simulator
from adaptsim_jax.tasks.pushing.slide import Lacking

_SMALL = 0.004  # m: gaps up to here are shown as they are, larger ones by their logarithm


def make_pushing_naf(config: PushingConfig) -> NAF:
    """The learner whose weights a `PushingPolicy` holds."""
    return make_naf(NAFConfig(obs_dim=2, action_dim=2, hidden=config.hidden))


def make_policy(
    config: PushingConfig = PushingConfig(),
) -> Callable[[PushingPolicy, jax.Array], jax.Array]:
    """`act(policy, goal [..., 2] m) -> [..., 2]`: the push for a goal, speed m/s and angle rad.
    Pure.
    """
    choose = make_choice(config)
    return lambda policy, goal: physical_action(choose(policy, goal))


def make_choice(config: PushingConfig) -> Callable[[PushingPolicy, jax.Array], jax.Array]:
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
    _checked(config)
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
        obs_dim=_obs_dim(config),
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
    _checked(config)
    simulate, space, act = make_simulator(config), pushing_space(config), make_policy(config)

    def expect(trajectory, policy):
        params = space.physical(policy.at)
        push = jax.vmap(lambda a: simulate(params, a))
        expected = _points(push(act(policy, trajectory.goals)))
        if policy.told is None:
            return trajectory._replace(expected=expected)
        # pushes of other actions than E's own: what E would have made them for (hindsight, as goals
        # are relabelled in training)
        return trajectory._replace(goals=expected[:, -1], expected=expected)

    return expect


def moved(policy: PushingPolicy, mean: jax.Array) -> PushingPolicy:
    """The policy for another mean of E `[D]` (unit coordinates), before any training there. As it
    is, if it knows no other.
    """
    if policy.tilt is None or policy.at is None:
        return policy
    return policy._replace(
        weights=move(policy.weights, policy.tilt, 2.0 * (mean - policy.at)), at=mean
    )


def _blank(weights: jax.Array, config: PushingConfig, space: Space) -> PushingPolicy:
    if not config.pretrain:
        return PushingPolicy(weights)
    return PushingPolicy(
        weights, jnp.zeros((space.dim, config.hidden[0])), jnp.full(space.dim, 0.5)
    )


def _pretrain(
    config: PushingConfig, space: Space, simulate: Callable
) -> Callable[[jax.Array], PushingPolicy]:
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


def measured(
    goals: jax.Array, places: jax.Array, tested: jax.Array | None = None
) -> PushingTrajectory:
    """The trajectory of `N` pushes for `goals [N, 2]` m from the bottle's `places [N, T, 2]` m at
    even times, from any backend or from a camera. The last row is the end.
    """
    return of_points(goals, _points(places), tested)


def _points(places: jax.Array) -> jax.Array:
    return places[:, observed_rows(places.shape[1])]


def of_points(
    goals: jax.Array, points: jax.Array, tested: jax.Array | None = None
) -> PushingTrajectory:
    """The same from the six points `[N, 6, 2]` m alone."""
    rewards = push_reward(points[:, -1], goals)
    return PushingTrajectory(goals, points, rewards, rewards.mean() if tested is None else tested)


def observed_rows(T: int) -> np.ndarray:
    """`[6]`: which of `T` rows the six points are."""
    return np.round(T * np.arange(1, POINTS + 1) / POINTS).astype(int) - 1


def observed(trajectory: PushingTrajectory, config: PushingConfig) -> jax.Array:
    """`[obs_dim]`: places, and goals where shown, in the network's coordinates; far out they are
    held at 4.
    """

    def given(points):
        if config.observation == "points":
            return points
        return points[:, -1:]

    if config.show_goal:
        shown = [given(trajectory.points), trajectory.goals[:, None]]
    else:
        shown = [given(trajectory.points)]
    observed = goal_input(jnp.concatenate(shown, 1))
    if config.show_gap:
        gap = given(trajectory.points) - given(trajectory.expected)
        # millimetres tell as much as centimetres do when E is nearly right
        observed = jnp.concatenate([observed, jnp.arcsinh(gap / _SMALL)], 1)
    return jnp.clip(jnp.where(jnp.isfinite(observed), observed, 4.0), -4.0, 4.0).reshape(-1)


def _obs_dim(config: PushingConfig) -> int:
    points = POINTS if config.observation == "points" else 1
    return config.trajectories * 2 * (points * (1 + config.show_gap) + config.show_goal)


def _problem(space: Space, simulate: Callable) -> GoalProblem:
    def trial(key, dist, action):
        params = space.physical(spaces.sample(key, dist))
        return simulate(params, physical_action(action))[-1]

    return GoalProblem(draw_goal, goal_input, trial, push_reward)


def naf_rates(config: PushingConfig, tuning: bool = False) -> Any:
    return NAFHyper(
        learning_rate=config.tuning_rate if tuning else config.learning_rate, max_grad_norm=10.0
    )


def _checked(config: PushingConfig) -> PushOptions:
    for name in ("trajectories", "tests", "trials"):
        if getattr(config, name) < 1:
            raise BadInput(f"pushing, {name} = {getattr(config, name)}: give at least 1")
    for name in ("learning_rate", "tuning_rate"):
        if getattr(config, name) <= 0:
            raise BadInput(
                f"pushing, {name} = {getattr(config, name)}: give a positive one, such as 1e-3"
            )
    if config.mended != Lacking() and config.simulator != "planar":
        raise BadInput(
            f"pushing, simulator = {config.simulator}: a mended push is simulated by the planar "
            "model; leave simulator out"
        )
    if len(config.fitted) not in (0, len(PARAMETERS)):
        raise BadInput(
            f"pushing, fitted = {list(config.fitted)}: give {', '.join(PARAMETERS)}, or leave it "
            "out"
        )
    if min(config.refine, *config.rehearsal) < 0:
        raise BadInput(
            f"pushing, refine = {config.refine}, rehearsal = {config.rehearsal}: give numbers of "
            "pushes, 0 for none"
        )
    if config.correct and not config.refine:
        raise BadInput(
            "pushing, correct: it is by refining that actions are corrected; give refine, such as 8"
        )
    if config.visits == "deployed" and not (config.correct and config.show_gap):
        raise BadInput(
            "pushing, visits = deployed: only corrected actions differ from E's own, and f tells "
            "them by the gap; set correct and show_gap"
        )
    if config.show_gap and not config.pretrain:
        raise BadInput(
            "pushing, show_gap: only a policy made with pretrain = true knows the mean of E that "
            "the gap is to; set it"
        )
    if config.refine and not config.pretrain:
        raise BadInput(
            "pushing, refine: only a policy made with pretrain = true knows the mean of E to try "
            "a push at; set it"
        )
    return planar.check_options(PushOptions(friction=config.friction, duration=config.duration))
