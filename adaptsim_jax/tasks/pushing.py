"""The bottle push (paper, section 5.2 and appendix A4): a NAF network chooses an open-loop push for a goal on the table.

The task policy is trained in the planar model at parameters drawn from E, with goals relabelled on stored pushes. At each
adaptation iteration it is tried on two goals; these two trajectories are all that the adaptation policy sees. In a
simulated target the reward is the mean over a fixed set of goals, `1 - distance / 0.2 m` and at least 0.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax import space as spaces
from adaptsim_jax.errors import BadInput
from adaptsim_jax.learners.naf import NAF, NAFConfig, NAFHyper, make_naf
from adaptsim_jax.learners.naf_goals import GoalConfig, GoalProblem, make_goal_learner
from adaptsim_jax.learners.naf_shared import SharedConfig, fold, make_shared_learner, move
from adaptsim_jax.models import pushing as model
from adaptsim_jax.models import pushing_planar as planar
from adaptsim_jax.models.pushing import PushOptions
from adaptsim_jax.space import Parameter, Space
from adaptsim_jax.tasks.base import Task
from adaptsim_jax.tasks.pushing_refine import refine, search
from adaptsim_jax.tasks.pushing_told import Told, nearer, with_gaps

# Paper, table A2: friction of the table, modulus of the bottle Pa, friction of the patch, its lateral place m.
SETTINGS = {
    "wd": {"mu": 0.1, "e": 1e5, "mu_p": 0.6, "y_p": 0.05},
    "ood-1": {"mu": 0.25, "e": 5e4, "mu_p": 0.1, "y_p": -0.1},
    "ood-2": {"mu": 0.05, "e": 1e5, "mu_p": 0.9, "y_p": 0.05},
    "ood-3": {"mu": 0.15, "e": 5e6, "mu_p": 0.1, "y_p": -0.15},
    "ood-4": {"mu": 0.30, "e": 1e5, "mu_p": 0.15, "y_p": 0.1},
}
TWINS = {"native": planar.DEFAULT, "drake": planar.DRAKE}
POINTS = 6
WORST = 0.2  # m: a bottle this far from its goal, or farther, earns nothing
GOAL_CENTRE, GOAL_RADII, GOAL_ANGLE = (
    (0.45, 0.0),
    (0.25, 0.55),
    0.175,
)  # a sector that x = 0.7 to 1.0 m and 10 degrees span
_SMALL = 0.004  # m: gaps up to here are shown as they are, larger ones by their logarithm
_MIDDLE, _HALF = np.array([0.85, 0.0]), np.array([0.15, 0.1])  # goals to [-1, 1], and what is seen of the bottle alike


@dataclass(frozen=True)
class PushingConfig:
    """Options of the task.

    observation: six points of each trajectory, or the `final` position alone (the paper's state-only variant).
    show_goal: observe also the goal of each push, without which a miss cannot be told from a far goal.
    show_gap: observe also how far the points lie from those of the same pushes simulated at the mean of E (`pretrain` only).
    trajectories: pushes an iteration; tests: goals that the reward of a simulated target is averaged over.
    goals: of an iteration's pushes: drawn anew; `spread`, drawn one in each equal part of the sector's angle and far out; or
    `fixed`, always the same, so that what is seen differs by parameters alone, or `edges`, likewise but near the sector's edges.
    targets: Phase 1 draws targets from Omega (the paper), or from a box around it (`wide`).
    trials: M, simulated pushes that `train` trains a policy with; training: how; hidden, learning_rate: of the NAF.
    pretrain: go on from one policy for all of Omega (`naf_shared`) instead of from nothing. It is made first, by `shared`
    with `learning_rate`; `train` then moves it to the mean of E and, unless `tune` is false, tunes it by `tuning` with
    `tuning_rate`.
    refine: pushes simulated at the mean of E that each action is corrected by before it is made (`pushing_refine`), with
    `pretrain` only; 0: actions are the network's own. correct: what is deployed is searched for in the simulator as
    mended by the pushes made in the target so far, near E's mean and over the actions (`pushing_told`); a visit's own pushes are
    not, nor is anything in Phase 1. rehearsal: tests and refine that Phase 1 makes do with, where not 0.
    coefficients: the planar model as a twin of the MuJoCo scene or of Drake's.
    friction, duration: of the model, see `models.pushing.PushOptions`. mu, e, mu_p, y_p: Omega.
    """

    observation: Literal["points", "final"] = "points"
    show_goal: bool = True
    show_gap: bool = False
    trajectories: int = 2
    tests: int = 24
    goals: Literal["drawn", "spread", "fixed", "edges"] = "drawn"
    targets: Literal["omega", "wide"] = "wide"
    trials: int = 10_000
    training: GoalConfig = field(
        default_factory=lambda: GoalConfig(updates=40, batch=32, candidates=16, temperature=0.03, width=(0.5, 0.05))
    )
    hidden: tuple[int, ...] = (64, 64)
    learning_rate: float = 3e-3
    pretrain: bool = False
    shared: SharedConfig = field(default_factory=SharedConfig)
    tuning: GoalConfig = field(
        default_factory=lambda: GoalConfig(
            updates=40, batch=32, temperature=0.015, width=(0.15, 0.03), near=1.0, uniform=0.25, noise=0.05
        )
    )
    tuning_rate: float = 1e-3
    tune: bool = True
    refine: int = 0
    correct: bool = False
    rehearsal: tuple[int, int] = (0, 0)
    coefficients: Literal["native", "drake"] = "native"
    friction: Literal["clean", "coupled"] = "clean"
    duration: float = 1.3
    mu: tuple[float, float] = (model.LOW[0], model.HIGH[0])
    e: tuple[float, float] = (model.LOW[1], model.HIGH[1])
    mu_p: tuple[float, float] = (model.LOW[2], model.HIGH[2])
    y_p: tuple[float, float] = (model.LOW[3], model.HIGH[3])


class PushingPolicy(NamedTuple):
    """weights: `[n]` of the NAF; `make_policy(config)` gives what it does. Where it came of one for all of Omega (else None):
    tilt: `[D, width]`, what E's mean adds to the first bias, and at: `[D]`, the mean (unit coordinates) that it stands for. told:
    pushes of the target that its actions are corrected by, where there are any (else None)."""

    weights: jax.Array
    tilt: jax.Array | None = None
    at: jax.Array | None = None
    told: Told | None = None


class PushingTrajectory(NamedTuple):
    """goals: `[N, 2]` m; points: `[N, 6, 2]` m, the bottle at six even times, the last at the end; rewards: `[N]` of these
    pushes; tested: `[]`, mean reward over the test goals (in simulation only; elsewhere the mean of `rewards`); expected:
    `[N, 6, 2]` m, the points of the same pushes simulated at the mean of E, where they are observed (else None)."""

    goals: jax.Array
    points: jax.Array
    rewards: jax.Array
    tested: jax.Array
    expected: jax.Array | None = None


def pushing_space(config: PushingConfig = PushingConfig()) -> Space:
    """Omega: two frictions, the modulus on a logarithmic scale, and the place of the patch."""
    bounds: list[dict[str, Any]] = [
        {"physical_low": a, "physical_high": b} for a, b in zip(model.PHYSICAL_LOW, model.PHYSICAL_HIGH, strict=True)
    ]
    return Space(
        (
            Parameter("mu", *config.mu, **bounds[0], description="friction of the table"),
            Parameter("e", *config.e, "Pa", "log", **bounds[1], description="modulus of the bottle's contact"),
            Parameter("mu_p", *config.mu_p, **bounds[2], description="friction of the patch"),
            Parameter("y_p", *config.y_p, "m", **bounds[3], description="lateral place of the patch"),
        )
    )


def wide_space() -> Space:
    """A box around Omega for Phase-1 targets that Omega cannot reproduce."""
    return Space(
        (
            Parameter("mu", 0.03, 0.35, "", "log"),
            Parameter("e", 5e3, 8e6, "Pa", "log"),
            Parameter("mu_p", 0.05, 1.0),
            Parameter("y_p", -0.17, 0.17, "m"),
        )
    )


def draw_goal(key: jax.Array) -> jax.Array:
    """A goal `[2]` m, uniform in radius and angle over the sector of goals."""
    return _goal_at(jax.random.uniform(key, (2,)))


def visit_goals(key: jax.Array, config: PushingConfig) -> jax.Array:
    """`[trajectories, 2]` m: the goals that an iteration tries a policy on."""
    n = config.trajectories
    if config.goals == "drawn":
        return jax.vmap(draw_goal)(jax.random.split(key, n))
    if config.goals == "edges":
        return _goal_at(jnp.stack([jnp.linspace(0.95, 0.6, n), jnp.linspace(0.12, 0.88, n)], -1))
    u = jax.random.uniform(key, (n, 2)) if config.goals == "spread" else jnp.full((n, 2), 0.5)
    u = u.at[:, 0].set(0.4 + 0.6 * u[:, 0]) if config.goals == "spread" else u.at[:, 0].set(jnp.linspace(0.9, 0.6, n))
    return _goal_at(u.at[:, 1].set((jnp.arange(n) + u[:, 1]) / n))


def _goal_at(u: jax.Array) -> jax.Array:
    radius = GOAL_RADII[0] + (GOAL_RADII[1] - GOAL_RADII[0]) * u[..., 0]
    angle = GOAL_ANGLE * (2.0 * u[..., 1] - 1.0)
    return jnp.stack([GOAL_CENTRE[0] + radius * jnp.cos(angle), GOAL_CENTRE[1] + radius * jnp.sin(angle)], -1)


def push_reward(final: jax.Array, goal: jax.Array) -> jax.Array:
    """`1 - distance / 0.2 m`, at least 0, of a bottle at `final [..., 2]`; 0 where it is not finite."""
    reward = jnp.maximum(0.0, 1.0 - jnp.linalg.norm(final - goal, axis=-1) / WORST)
    return jnp.where(jnp.isfinite(reward), reward, 0.0)


def physical_action(action: jax.Array) -> jax.Array:
    """`[..., 2]` in [-1, 1] to speed m/s and angle rad."""
    low, high = jnp.asarray(model.ACTION_LOW), jnp.asarray(model.ACTION_HIGH)
    lead = (1,) * (action.ndim - 1)
    return (low + high).reshape(*lead, 2) / 2 + action * (high - low).reshape(*lead, 2) / 2


def seen_goal(goal: jax.Array) -> jax.Array:
    """A place on the table `[..., 2]` m in the network's coordinates; goals span [-1, 1]."""
    lead = (1,) * (goal.ndim - 1)
    return (goal - jnp.asarray(_MIDDLE, goal.dtype).reshape(*lead, 2)) / jnp.asarray(_HALF, goal.dtype).reshape(
        *lead, 2
    )


def unseen(place: jax.Array) -> jax.Array:
    """`seen_goal` undone: `[..., 2]` m."""
    lead = (1,) * (place.ndim - 1)
    return place * jnp.asarray(_HALF, place.dtype).reshape(*lead, 2) + jnp.asarray(_MIDDLE, place.dtype).reshape(
        *lead, 2
    )


def make_pushing_naf(config: PushingConfig) -> NAF:
    """The learner whose weights a `PushingPolicy` holds."""
    return make_naf(NAFConfig(obs_dim=2, action_dim=2, hidden=config.hidden))


def make_policy(config: PushingConfig = PushingConfig()) -> Callable[[PushingPolicy, jax.Array], jax.Array]:
    """`act(policy, goal [..., 2] m) -> [..., 2]`: the push for a goal, speed m/s and angle rad. Pure."""
    choose = make_choice(config)
    return lambda policy, goal: physical_action(choose(policy, goal))


def make_choice(config: PushingConfig) -> Callable[[PushingPolicy, jax.Array], jax.Array]:
    """The same with actions in [-1, 1]. A policy for no E in particular (UDR's) is not refined: there is no mean to try it at."""
    naf, space, twin = make_pushing_naf(config), pushing_space(config), TWINS[config.coefficients]
    options = PushOptions(friction=config.friction, duration=config.duration)

    def choose(policy, goal):
        action = naf.greedy(policy.weights, seen_goal(goal))
        if config.refine == 0 or policy.at is None:
            return action
        goals, first = goal.reshape(-1, 2), action.reshape(-1, 2)
        end = lambda at, a: planar.rollout(space.physical(at), physical_action(a), options, twin)[-1]
        if policy.told is None:
            push = lambda a: end(policy.at, a)
            better = jax.vmap(lambda g, a: refine(push, g, a, config.refine))(goals, first)
        else:
            at = nearer(end, policy.at, policy.told)
            push = with_gaps(lambda a: end(at, a), policy.told)
            better = search(push, goals, first, config.refine, policy.told.used.any())
        return better.reshape(action.shape)

    return choose


def make_pushing(config: PushingConfig = PushingConfig()) -> Task:
    """The push as a `Task`, simulated with the planar model."""
    options, twin = _checked(config), TWINS[config.coefficients]
    space, naf = pushing_space(config), make_pushing_naf(config)
    how = config.tuning if config.pretrain else config.training
    learner = make_goal_learner(naf, _problem(space, options, twin), how, naf_rates(config, config.pretrain))
    block = how.block

    def train_many(keys, dists, policies, trials):
        rounds = (trials + block - 1) // block
        policies = jax.vmap(moved)(policies, dists.mean)
        if config.pretrain and not config.tune:
            return policies
        return policies._replace(weights=learner.train(keys, policies.weights, dists, rounds, jnp.max(rounds)))

    def train(key, dist, policy):
        one = jax.tree.map(lambda x: x[None], (dist, policy))
        trained = train_many(key[None], *one, jnp.full(1, config.trials))
        return jax.tree.map(lambda x: x[0], trained)

    tests, refinement = (a or b for a, b in zip(config.rehearsal, (config.tests, config.refine), strict=True))
    rehearsed = replace(config, tests=tests, refine=refinement)
    return Task(
        name="pushing",
        space=space,
        targets=space if config.targets == "omega" else wide_space(),
        obs_dim=_obs_dim(config),
        settings=SETTINGS,
        init_policy=lambda key: _blank(naf.init(key).online, config, space),
        train=train,
        rollout=_make_rollout(config, options, twin),
        observe=lambda trajectory: observed(trajectory, config),
        score=lambda trajectory: trajectory.rewards.mean(),
        reference=lambda params: jnp.zeros(()),
        reward=lambda trajectory, reference: trajectory.tested,
        train_many=train_many,
        rehearse=None if rehearsed == config else _make_rollout(rehearsed, options, twin),
        pretrain=_pretrain(config, space, options, twin) if config.pretrain else None,
    )


def _make_rollout(config: PushingConfig, options: PushOptions, twin: planar.PlanarCoefficients) -> Callable:
    """`(key, policy, params [D]) -> PushingTrajectory`: the visit's pushes, and the tests that its reward is the mean of."""
    grid, act, expect = goal_lattice(config.tests), make_policy(config), make_expectation(config)

    def rollout(key, policy, params):
        goals = visit_goals(key, config)
        push = jax.vmap(lambda a: planar.rollout(params, a, options, twin))
        # apart, so that the compiler leaves the test goals out where only the observation is asked for
        tested = push_reward(push(act(policy, grid))[:, -1], grid).mean()
        return expect(measured(goals, push(act(policy, goals)), tested), policy)

    return rollout


def make_expectation(config: PushingConfig) -> Callable[[PushingTrajectory, PushingPolicy], PushingTrajectory]:
    """`expect(trajectory, policy)`: the trajectory of the policy's pushes, from any engine, with what they do at the mean of E."""
    if not config.show_gap:
        return lambda trajectory, policy: trajectory
    options, space, act = _checked(config), pushing_space(config), make_policy(config)

    def expect(trajectory, policy):
        params = space.physical(policy.at)
        push = jax.vmap(lambda a: planar.rollout(params, a, options, TWINS[config.coefficients]))
        return trajectory._replace(expected=_points(push(act(policy, trajectory.goals))))

    return expect


def moved(policy: PushingPolicy, mean: jax.Array) -> PushingPolicy:
    """The policy for another mean of E `[D]` (unit coordinates), before any training there; as it is, if it knows no other."""
    if policy.tilt is None:
        return policy
    return policy._replace(weights=move(policy.weights, policy.tilt, 2.0 * (mean - policy.at)), at=mean)


def _blank(weights: jax.Array, config: PushingConfig, space: Space) -> PushingPolicy:
    if not config.pretrain:
        return PushingPolicy(weights)
    return PushingPolicy(weights, jnp.zeros((space.dim, config.hidden[0])), jnp.full(space.dim, 0.5))


def _pretrain(config: PushingConfig, space: Space, options: PushOptions, twin) -> Callable[[jax.Array], PushingPolicy]:
    """`(key) -> policy` for all of Omega, at its centre; it was shown means in [-1, 1]."""
    wide = make_naf(NAFConfig(obs_dim=2 + space.dim, action_dim=2, hidden=config.hidden))
    trial = lambda key, u, action: planar.rollout(space.physical(u), physical_action(action), options, twin)[-1]
    problem = GoalProblem(draw_goal, seen_goal, trial, push_reward)
    learn = make_shared_learner(wide, problem, space.sample, lambda u: 2.0 * u - 1.0, config.shared, naf_rates(config))

    def pretrain(key):
        weights, tilt = fold(learn(key), 2, space.dim, config.hidden[0])
        return PushingPolicy(weights, tilt, jnp.full(space.dim, 0.5))

    return pretrain


def measured(goals: jax.Array, places: jax.Array, tested: jax.Array | None = None) -> PushingTrajectory:
    """The trajectory of `N` pushes for `goals [N, 2]` m from the bottle's `places [N, T, 2]` m at even times, from any
    backend or from a camera; the last row is the end."""
    return of_points(goals, _points(places), tested)


def _points(places: jax.Array) -> jax.Array:
    return places[:, observed_rows(places.shape[1])]


def of_points(goals: jax.Array, points: jax.Array, tested: jax.Array | None = None) -> PushingTrajectory:
    """The same from the six points `[N, 6, 2]` m alone."""
    rewards = push_reward(points[:, -1], goals)
    return PushingTrajectory(goals, points, rewards, rewards.mean() if tested is None else tested)


def observed_rows(T: int) -> np.ndarray:
    """`[6]`: which of `T` rows the six points are."""
    return np.round(T * np.arange(1, POINTS + 1) / POINTS).astype(int) - 1


def observed(trajectory: PushingTrajectory, config: PushingConfig) -> jax.Array:
    """`[obs_dim]`: places, and goals where shown, in the network's coordinates; far out they are held at 4."""
    told = lambda points: points if config.observation == "points" else points[:, -1:]
    shown = [told(trajectory.points), trajectory.goals[:, None]] if config.show_goal else [told(trajectory.points)]
    seen = seen_goal(jnp.concatenate(shown, 1))
    if config.show_gap:
        gap = told(trajectory.points) - told(trajectory.expected)
        # millimetres tell as much as centimetres do when E is nearly right
        seen = jnp.concatenate([seen, jnp.arcsinh(gap / _SMALL)], 1)
    return jnp.clip(jnp.where(jnp.isfinite(seen), seen, 4.0), -4.0, 4.0).reshape(-1)


def _obs_dim(config: PushingConfig) -> int:
    points = POINTS if config.observation == "points" else 1
    return config.trajectories * 2 * (points * (1 + config.show_gap) + config.show_goal)


def _problem(space: Space, options: PushOptions, twin: planar.PlanarCoefficients) -> GoalProblem:
    def trial(key, dist, action):
        params = space.physical(spaces.sample(key, dist))
        return planar.rollout(params, physical_action(action), options, twin)[-1]

    return GoalProblem(draw_goal, seen_goal, trial, push_reward)


def goal_lattice(count: int) -> jax.Array:
    """`[count, 2]` m: goals spread over the sector, the same for every policy (a golden-ratio lattice)."""
    row = np.arange(count) + 0.5
    u = np.stack([row / count, row * 0.6180339887 % 1.0], -1)
    return _goal_at(jnp.asarray(u, jnp.float32))


def naf_rates(config: PushingConfig, tuning: bool = False) -> Any:
    return NAFHyper(learning_rate=config.tuning_rate if tuning else config.learning_rate, max_grad_norm=10.0)


def _checked(config: PushingConfig) -> PushOptions:
    for name in ("trajectories", "tests", "trials"):
        if getattr(config, name) < 1:
            raise BadInput(f"pushing, {name} = {getattr(config, name)}: give at least 1")
    for name in ("learning_rate", "tuning_rate"):
        if getattr(config, name) <= 0:
            raise BadInput(f"pushing, {name} = {getattr(config, name)}: give a positive one, such as 1e-3")
    if min(config.refine, *config.rehearsal) < 0:
        raise BadInput(
            f"pushing, refine = {config.refine}, rehearsal = {config.rehearsal}: give numbers of pushes, 0 for none"
        )
    if config.correct and not config.refine:
        raise BadInput("pushing, correct: it is by refining that actions are corrected; give refine, such as 8")
    if config.refine and not config.pretrain:
        raise BadInput(
            "pushing, refine: only a policy made with pretrain = true knows the mean of E to try a push at; set it"
        )
    return planar.check_options(PushOptions(friction=config.friction, duration=config.duration))
