"""The push as a point on a line: a reduced model for sweeps, in JAX, calibrated against the full
scenes.

The paper's bottle hardly turns, so it stays on the line of the push: state (s, v) along it. The
plate's edge is prescribed, meets the bottle as the MuJoCo scenes do (a damped spring softened by
its impedance), and lifts some of its weight. Each point of the sole has the friction of what it
stands on.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.pushing import model as pushing
from adaptsim_jax.tasks.pushing.model import PAPER, ElasticityMap, PushOptions

Array = Any

STEP = 0.005
IMPEDANCE = 0.9  # of plate against bottle, as in the MJCF scene


class PlanarCoefficients(NamedTuple):
    """What calibration sets: the map of e, the share of the push that lifts, and the size of the
    sole by the bottle's.
    """

    elasticity: ElasticityMap
    lift: Any = 0.3
    sole: Any = 1.0


DEFAULT = PlanarCoefficients(
    ElasticityMap((3.685, 0.224, 0.268), (-1.460, 0.301, 0.055), (-0.449, 0.824)), 0.292, 1.002
)
"""A twin of the MuJoCo scene, DRAKE of Drake's: both by `experiments/pushing_elasticity.py --fit
planar`.
"""
DRAKE = PlanarCoefficients(
    ElasticityMap((3.620, 0.241, 0.301), (-1.480, 0.330, 0.070), (-0.670, 0.762)), 0.278, 0.899
)
TWINS = {"native": DEFAULT, "drake": DRAKE}


def check_options(options: PushOptions) -> PushOptions:
    """`options` if a bottle that neither turns nor tips is a fair model of them; BadInput
    otherwise.
    """
    if min(options.inertia) < 0.03 or max(map(abs, options.com[:2])) > 1e-3:
        raise BadInput(
            f"pushing, inertia = {options.inertia}, com = {options.com}: this bottle turns or "
            "tips, and the planar model only slides; use backend native, mjx or drake"
        )
    return pushing.check_options(options)


def rollout(
    params: Array,
    action: Array,
    options: PushOptions = PAPER,
    coefficients: PlanarCoefficients = DEFAULT,
    start: Array = pushing.START,
) -> Array:
    """Bottle positions `[T, 2]` m of one push: `params [4]`, `action [2]` (speed m/s, angle rad);
    pure, jit and vmap it.

    Row k is at `(k + 1) * options.row` s, 130 rows by default. `options` is static. Finite for
    finite input.
    """
    return trajectory(params, action, options, coefficients, start)[:, :2]


def trajectory(
    params: Array,
    action: Array,
    options: PushOptions = PAPER,
    coefficients: PlanarCoefficients = DEFAULT,
    start: Array = pushing.START,
) -> Array:
    """As `rollout`, with velocities: `[T, 4]`, x, y in m and vx, vy in m/s."""
    params, action, start = jnp.asarray(params), jnp.asarray(action), jnp.asarray(start)
    heading = jnp.stack([jnp.cos(action[1]), jnp.sin(action[1])])
    step = _make_step(params, action, heading, start, options, coefficients)
    # the pusher starts behind `START`, wherever the bottle stands; all along the line of the push
    ahead = (jnp.asarray(pushing.START) - start) @ heading - (
        pushing.LINK_BACK - pushing.EDGE_RADIUS - pushing.RADIUS
    )

    def row(state, edges):
        for (
            edge
        ) in edges:  # two: unrolled. Scaled here, so that no push holds 780 numbers of its own
            position, speed, acceleration = (_scaled(edge, k, action[0]) for k in range(3))
            state = step(state, (position + ahead, speed, acceleration))
        return state, state

    still = (
        0.0 * action[0] + 0.0 * params[0]
    )  # a zero of the inputs' type, so that the scan carries one type
    edges = jnp.asarray(edge_motion(options.duration)).reshape(-1, round(options.row / STEP), 6)
    _, (s, v) = jax.lax.scan(row, (still, still), edges, unroll=2)
    x, y = start[0] + s * heading[0], start[1] + s * heading[1]
    return jnp.stack([x, y, v * heading[0], v * heading[1]], -1)


def edge_motion(duration: float, step: float = STEP) -> np.ndarray:
    """`[steps, 6]`: position, speed, acceleration of the edge at step starts, each as (per unit
    speed, by pitching).
    """
    steps = round(duration / step)
    slope = pushing.slopes(step, steps)
    rate = pushing.ramp(np.arange(steps) * step)
    travel = np.concatenate([[0.0], np.cumsum(pushing.ramp(np.arange(1, steps) * step)) * step])
    return edge_of(travel, rate, slope)


def edge_of(travel: np.ndarray, rate: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """`[steps, 6]` of how far the profile has come, its rate and its slope `[steps]`."""
    pitch, rate_p, slope_p = (pushing.PITCH_RATE * a for a in (travel, rate, slope))
    swing = pushing.EDGE_DROP * np.sin(pitch)
    swing_v = pushing.EDGE_DROP * np.cos(pitch) * rate_p
    swing_a = pushing.EDGE_DROP * (np.cos(pitch) * slope_p - np.sin(pitch) * rate_p**2)
    return np.stack([travel, swing, rate, swing_v, slope, swing_a], -1).astype(np.float32)


def _scaled(edge: Array, k: int, speed: Array) -> Array:
    return speed * edge[2 * k] + edge[2 * k + 1]


def _make_step(params, action, heading, start, options: PushOptions, c: PlanarCoefficients):
    """`step((s, v), (gap, speed, acceleration)) -> (s, v)`: one semi-implicit Euler step of 5
    ms.
    """
    friction = pushing.frictions(params, options.friction)
    k, b = pushing.spring(c.elasticity, params[1], action[0], options.mass, jnp)
    points = pushing.sole().tolist()
    g, d = pushing.GRAVITY, IMPEDANCE

    def step(state, push):
        s, v = state
        # point by point rather than as an array: the compiler makes one loop over the batch of it,
        # a third faster
        at = (start[0] + s * heading[0], start[1] + s * heading[1])
        covered = sum(
            pushing.on_patch(at[0] + c.sole * x, at[1] + c.sole * y, params[3], jnp)
            for x, y in points
        )
        mu = friction.table + covered / len(points) * (friction.patch - friction.table)
        depth = push[0] - s
        # MuJoCo's contact: the force that brings the relative acceleration to its reference, short
        # of it by d
        free = push[2] + jnp.where(v > 0, mu * g, 0.0)
        touching = depth > 0
        pressed = b * (push[1] - v) + k * depth + d * free
        force = jnp.where(touching, jnp.maximum(pressed, 0.0), 0.0)
        brake = mu * jnp.maximum(g - c.lift * force, 0.0)
        v = v + STEP * force
        v = jnp.sign(v) * jnp.maximum(jnp.abs(v) - STEP * brake, 0.0)
        return s + STEP * v, v

    return step
