"""Goals of the push: which are drawn and tested, what a push earns, and the coordinates of goals
and actions in the network.
"""

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.tasks.pushing import model
from adaptsim_jax.tasks.pushing.config import PushingConfig

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
    if config.goals == "spread":
        u = jax.random.uniform(key, (n, 2))
    else:
        u = jnp.full((n, 2), 0.5)
    if config.goals == "spread":
        u = u.at[:, 0].set(0.4 + 0.6 * u[:, 0])
    else:
        u = u.at[:, 0].set(jnp.linspace(0.9, 0.6, n))
    return _goal_at(u.at[:, 1].set((jnp.arange(n) + u[:, 1]) / n))


def sector_goals(key: jax.Array, parts: int, each: int) -> jax.Array:
    """`[parts, each, 2]` m: goals drawn in each equal part of the sector's angle, near ones as
    likely as far ones.
    """
    u = jax.random.uniform(key, (parts, each, 2))
    return _goal_at(u.at[..., 1].set((jnp.arange(parts)[:, None] + u[..., 1]) / parts))


def _goal_at(u: jax.Array) -> jax.Array:
    radius = GOAL_RADII[0] + (GOAL_RADII[1] - GOAL_RADII[0]) * u[..., 0]
    angle = GOAL_ANGLE * (2.0 * u[..., 1] - 1.0)
    return jnp.stack(
        [GOAL_CENTRE[0] + radius * jnp.cos(angle), GOAL_CENTRE[1] + radius * jnp.sin(angle)], -1
    )


def push_reward(final: jax.Array, goal: jax.Array) -> jax.Array:
    """`1 - distance / 0.2 m`, at least 0, of a bottle at `final [..., 2]`; 0 where it is not
    finite.
    """
    reward = jnp.maximum(0.0, 1.0 - jnp.linalg.norm(final - goal, axis=-1) / WORST)
    return jnp.where(jnp.isfinite(reward), reward, 0.0)


def physical_action(action: jax.Array) -> jax.Array:
    """`[..., 2]` in [-1, 1] to speed m/s and angle rad."""
    low, high = jnp.asarray(model.ACTION_LOW), jnp.asarray(model.ACTION_HIGH)
    lead = (1,) * (action.ndim - 1)
    return (low + high).reshape(*lead, 2) / 2 + action * (high - low).reshape(*lead, 2) / 2


def goal_input(goal: jax.Array) -> jax.Array:
    """A place on the table `[..., 2]` m in the network's coordinates; goals span [-1, 1]."""
    lead = (1,) * (goal.ndim - 1)
    return (goal - jnp.asarray(_MIDDLE, goal.dtype).reshape(*lead, 2)) / jnp.asarray(
        _HALF, goal.dtype
    ).reshape(*lead, 2)


def unseen(place: jax.Array) -> jax.Array:
    """`goal_input` undone: `[..., 2]` m."""
    lead = (1,) * (place.ndim - 1)
    return place * jnp.asarray(_HALF, place.dtype).reshape(*lead, 2) + jnp.asarray(
        _MIDDLE, place.dtype
    ).reshape(*lead, 2)


def goal_lattice(count: int) -> jax.Array:
    """`[count, 2]` m: goals spread over the sector, the same for every policy (a golden-ratio
    lattice).
    """
    row = np.arange(count) + 0.5
    u = np.stack([row / count, row * 0.6180339887 % 1.0], -1)
    return _goal_at(jnp.asarray(u, jnp.float32))
