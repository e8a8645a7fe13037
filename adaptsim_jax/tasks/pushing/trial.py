"""A push and what comes of it: goals, what a push earns, and what the adaptation policy observes.
And which engine it is simulated in where E is tried.
"""

import functools
from collections.abc import Callable
from dataclasses import asdict

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from adaptsim_jax.tasks.pushing import model, planar, slide
from adaptsim_jax.tasks.pushing.config import PushingConfig, PushingTrajectory
from adaptsim_jax.tasks.pushing.model import PushOptions

WORST = 0.2  # m: a bottle this far from its goal, or farther, earns nothing
GOAL_CENTRE, GOAL_RADII, GOAL_ANGLE = (
    (0.45, 0.0),
    (0.25, 0.55),
    0.175,
)  # a sector that x = 0.7 to 1.0 m and 10 degrees span
_MIDDLE, _HALF = (
    np.array([0.85, 0.0]),
    np.array([0.15, 0.1]),
)  # goals to [-1, 1], and what is seen of the bottle alike


def draw_goal(key: Array) -> Array:
    """A goal `[2]` m, uniform in radius and angle over the sector of goals."""
    return _goal_at(jax.random.uniform(key, (2,)))


def visit_goals(key: Array, config: PushingConfig) -> Array:
    """`[trajectories, 2]` m: the goals that an iteration tries a policy on."""
    n = config.trajectories
    if config.goals == "drawn":
        return jax.vmap(draw_goal)(jax.random.split(key, n))
    if config.goals == "edges":
        return _goal_at(jnp.stack([jnp.linspace(0.95, 0.6, n), jnp.linspace(0.12, 0.88, n)], -1))
    if config.goals == "spread":
        u = jax.random.uniform(key, (n, 2))
    else:
        u = jnp.full((n, 2), 0.5)
    if config.goals == "spread":
        u = u.at[:, 0].set(0.4 + 0.6 * u[:, 0])
    else:
        u = u.at[:, 0].set(jnp.linspace(0.9, 0.6, n))
    return _goal_at(u.at[:, 1].set((jnp.arange(n) + u[:, 1]) / n))


def sector_goals(key: Array, parts: int, each: int) -> Array:
    """`[parts, each, 2]` m: goals drawn in each equal part of the sector's angle, near ones as
    likely as far ones.
    """
    u = jax.random.uniform(key, (parts, each, 2))
    return _goal_at(u.at[..., 1].set((jnp.arange(parts)[:, None] + u[..., 1]) / parts))


def _goal_at(u: Array) -> Array:
    radius = GOAL_RADII[0] + (GOAL_RADII[1] - GOAL_RADII[0]) * u[..., 0]
    angle = GOAL_ANGLE * (2.0 * u[..., 1] - 1.0)
    x = GOAL_CENTRE[0] + radius * jnp.cos(angle)
    y = GOAL_CENTRE[1] + radius * jnp.sin(angle)
    return jnp.stack([x, y], -1)


def push_reward(final: Array, goal: Array) -> Array:
    """`1 - distance / 0.2 m`, at least 0, of a bottle at `final [..., 2]`; 0 where it is not
    finite.
    """
    reward = jnp.maximum(0.0, 1.0 - jnp.linalg.norm(final - goal, axis=-1) / WORST)
    return jnp.where(jnp.isfinite(reward), reward, 0.0)


def physical_action(action: Array) -> Array:
    """`[..., 2]` in [-1, 1] to speed m/s and angle rad."""
    low, high = jnp.asarray(model.ACTION_LOW), jnp.asarray(model.ACTION_HIGH)
    lead = (1,) * (action.ndim - 1)
    return (low + high).reshape(*lead, 2) / 2 + action * (high - low).reshape(*lead, 2) / 2


def goal_input(goal: Array) -> Array:
    """A place on the table `[..., 2]` m in the network's coordinates; goals span [-1, 1]."""
    lead = (1,) * (goal.ndim - 1)
    return (goal - jnp.asarray(_MIDDLE, goal.dtype).reshape(*lead, 2)) / jnp.asarray(
        _HALF, goal.dtype
    ).reshape(*lead, 2)


def unseen(place: Array) -> Array:
    """`goal_input` undone: `[..., 2]` m."""
    lead = (1,) * (place.ndim - 1)
    return place * jnp.asarray(_HALF, place.dtype).reshape(*lead, 2) + jnp.asarray(
        _MIDDLE, place.dtype
    ).reshape(*lead, 2)


def goal_lattice(count: int) -> Array:
    """`[count, 2]` m: goals spread over the sector, the same for every policy (a golden-ratio
    lattice).
    """
    row = np.arange(count) + 0.5
    u = np.stack([row / count, row * 0.6180339887 % 1.0], -1)
    return _goal_at(jnp.asarray(u, jnp.float32))


POINTS = 6
STEP = 0.0025  # s, of a mended slide

Push = Callable[[Array, Array], Array]


def make_simulator(config: PushingConfig) -> Push:
    """`push(params [4], action [2]) -> [T, 2]` m, the bottle at even times (action: speed m/s,
    angle rad). Pure; T is what the engine gives, the six observed points at least, and the last is
    the end.
    """
    if config.simulator == "planar":
        return _twin(config)
    options = PushOptions(friction=config.friction, duration=config.duration)
    if config.simulator == "mjx":
        return _in_mjx(options)
    from adaptsim_jax.tasks.pushing.engines.served import make_served

    return make_served(options, POINTS)


def make_guide(config: PushingConfig) -> Push | None:
    """A cheaper simulator to take slopes from, where there is one: the MuJoCo scene's planar
    twin.
    """
    if config.simulator == "planar":
        return None
    return _twin(config)


@functools.cache
def _in_mjx(options: PushOptions) -> Push:
    """The scene in MJX, from where bottles start."""
    from adaptsim_jax.tasks.pushing.engines.mujoco import make_push

    with (
        jax.ensure_compile_time_eval()
    ):  # the model is kept, and must hold no tracers of a caller's program
        simulate = make_push(model.check_options(options), model.ELASTICITY)

    @jax.jit  # traced once, though Phase 1 pushes in many places
    def push(params, action):
        # MJX relies on rank promotion, which a strict caller may have forbidden
        with jax.numpy_rank_promotion("allow"):
            return simulate(params, action, jnp.asarray(model.START, params.dtype))[:, :2]

    return push


def _twin(config: PushingConfig) -> Push:
    options, twin = (
        PushOptions(friction=config.friction, duration=config.duration),
        planar.TWINS[config.coefficients],
    )
    if config.mended == slide.Lacking():
        return lambda params, action: planar.rollout(params, action, options, twin)
    lacking, every = asdict(config.mended), round(options.row / slide.ROW)

    def push(params, action):
        values = lacking | {name: params[i] for i, name in enumerate(model.PARAMETERS)}
        return slide.rollout(values, action, options, twin, step=STEP)[every::every, :2]

    return push


_SMALL = 0.004  # m: gaps up to here are shown as they are, larger ones by their logarithm


def measured(goals: Array, places: Array, tested: Array | None = None) -> PushingTrajectory:
    """The trajectory of `N` pushes for `goals [N, 2]` m from the bottle's `places [N, T, 2]` m at
    even times, from any backend or from a camera. The last row is the end.
    """
    return of_points(goals, observed_points(places), tested)


def observed_points(places: Array) -> Array:
    return places[:, observed_rows(places.shape[1])]


def of_points(goals: Array, points: Array, tested: Array | None = None) -> PushingTrajectory:
    """The same from the six points `[N, 6, 2]` m alone."""
    rewards = push_reward(points[:, -1], goals)
    return PushingTrajectory(goals, points, rewards, rewards.mean() if tested is None else tested)


def observed_rows(T: int) -> np.ndarray:
    """`[6]`: which of `T` rows the six points are."""
    return np.round(T * np.arange(1, POINTS + 1) / POINTS).astype(int) - 1


def observed(trajectory: PushingTrajectory, config: PushingConfig) -> Array:
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
        assert trajectory.expected is not None
        gap = given(trajectory.points) - given(trajectory.expected)
        # millimetres tell as much as centimetres do when E is nearly right
        observed = jnp.concatenate([observed, jnp.arcsinh(gap / _SMALL)], 1)
    return jnp.clip(jnp.where(jnp.isfinite(observed), observed, 4.0), -4.0, 4.0).reshape(-1)


def obs_dim(config: PushingConfig) -> int:
    points = POINTS if config.observation == "points" else 1
    return config.trajectories * 2 * (points * (1 + config.show_gap) + config.show_goal)
