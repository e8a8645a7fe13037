"""The push with a slide in two dimensions, in JAX: the planar model with a velocity that need not be along the push.

Where nothing pushes sideways it is `planar.trajectory` at the same step, to rounding. `STEP` is a tenth of planar's 5 ms, since a
recording resolves what the longer step does (2.7 mm at a push's end in the median). Every effect is a number of `Push` that is zero
where the effect is absent; the bottle does not turn.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.tasks.pushing import model as pushing
from adaptsim_jax.tasks.pushing.planar import DEFAULT, IMPEDANCE, PlanarCoefficients

STEP = 5e-4  # s
ROW = 5e-3  # s between rows
GRIP = 0.3  # friction of plate against bottle


class Push(NamedTuple):
    """Declared parameters mu, e Pa, mu_p, y_p m; then effects, all zero where absent.

    Command: speed_scale (share), speed_offset m/s, heading rad, late s; start_x, start_y m beside `model.START`. Contact: hit, the
    change of the spring's frequency with the logarithm of the hit's speed. Force: tilt_x, tilt_y rad (the table falls towards +x,
    +y), viscous 1/s, quadratic 1/m, grain (share by which friction across the grain is larger) at grain_angle rad, patch_x m,
    patch_side m (shift and growth of the patch), spot (friction of one more patch beyond the table's) at spot_x, spot_y m.
    """

    mu: Any
    e: Any
    mu_p: Any
    y_p: Any
    speed_scale: Any = 0.0
    speed_offset: Any = 0.0
    heading: Any = 0.0
    late: Any = 0.0
    start_x: Any = 0.0
    start_y: Any = 0.0
    hit: Any = 0.0
    tilt_x: Any = 0.0
    tilt_y: Any = 0.0
    viscous: Any = 0.0
    quadratic: Any = 0.0
    grain: Any = 0.0
    grain_angle: Any = 0.0
    patch_x: Any = 0.0
    patch_side: Any = 0.0
    spot: Any = 0.0
    spot_x: Any = 0.0
    spot_y: Any = 0.0


def _inside(d, side):
    return jnp.clip((side / 2 - jnp.abs(d)) / pushing.PATCH_EDGE + 0.5, 0.0, 1.0)


@partial(jax.jit, static_argnames=("duration", "coefficients", "step"))
def slide(
    push: Push, action, duration: float = 1.3, coefficients: PlanarCoefficients = DEFAULT, step: float = STEP
) -> jax.Array:
    """Bottle positions and velocities [T + 1, 4] (m, m/s) of one push `action [2]` (m/s, rad), from its start, every 5 ms; pure."""
    count, every = round(duration / ROW), round(ROW / step)
    speed = action[0] * (1.0 + push.speed_scale) + push.speed_offset
    angle = action[1] + push.heading
    along = jnp.stack([jnp.cos(angle), jnp.sin(angle)])
    side = jnp.stack([-along[1], along[0]])
    start = jnp.asarray(pushing.START) + jnp.stack([push.start_x, push.start_y])
    # the plate's edge, from behind the place where the bottle should stand
    ahead = (jnp.asarray(pushing.START) - start) @ along - (pushing.LINK_BACK - pushing.EDGE_RADIUS - pushing.RADIUS)
    c, g = coefficients, pushing.GRAVITY
    frequency = c.elasticity.speed[0] + push.hit
    law = c.elasticity._replace(speed=(frequency, c.elasticity.speed[1]))
    k, b = pushing.spring(law, push.e, speed, pushing.NOMINAL_MASS, jnp)
    points = jnp.asarray(pushing.sole()) * c.sole
    turn = jnp.stack([jnp.cos(push.grain_angle), jnp.sin(push.grain_angle)])
    pull = g * jnp.stack([jnp.sin(push.tilt_x), jnp.sin(push.tilt_y)])
    table = _edge(round(duration / step) + 1, step)
    shifted = jnp.arange(count * every) - push.late / step

    def once(state, at):
        x, v = state[:2], state[2:]
        low = jnp.clip(jnp.floor(at).astype(jnp.int32), 0, len(table) - 2)
        share = jnp.clip(at - low, 0.0, 1.0)
        rows = table[low] * (1.0 - share) + table[low + 1] * share
        edge, edge_v, edge_a = (speed * rows[i] + rows[i + 1] for i in (0, 2, 4))
        feet = x[None] + points
        covered = (_inside(feet[:, 0] - pushing.PATCH_X - push.patch_x, pushing.PATCH_SIDE + push.patch_side)
                   * _inside(feet[:, 1] - push.y_p, pushing.PATCH_SIDE + push.patch_side)).mean()  # fmt: skip
        spot = (_inside(feet[:, 0] - push.spot_x, SPOT) * _inside(feet[:, 1] - push.spot_y, SPOT)).mean()
        mu = push.mu + covered * (push.mu_p - push.mu) + spot * push.spot
        s, vs, vt = (x - start) @ along, v @ along, v @ side
        depth = edge + ahead - s
        free = edge_a + jnp.where(vs > 0, mu * g, 0.0)
        force = jnp.where(depth > 0, jnp.maximum(b * (edge_v - vs) + k * depth + IMPEDANCE * free, 0.0), 0.0)
        slip = jnp.clip(-vt / step, -GRIP * force, GRIP * force)  # the plate's own friction, sideways
        fast = jnp.sqrt(v @ v + 1e-18)
        v = v + step * (force * along + slip * side + pull)
        brake = mu * jnp.maximum(g - c.lift * force, 0.0) + push.viscous * fast + push.quadratic * fast**2
        size = jnp.sqrt(v @ v + 1e-18)
        way = v / size
        across = way - (way @ turn) * turn
        way = way + push.grain * across
        left = 1.0 - step * brake * (way @ v) / size**2
        v = jnp.where((left > 0.0) & (size > 1e-8), v - step * brake * way, 0.0)
        return jnp.concatenate([x + step * v, v]), None

    def row(state, at):
        state, _ = jax.lax.scan(once, state, at)
        return state, state

    first = jnp.concatenate([start, jnp.zeros(2)]) + 0.0 * push.mu
    _, rows = jax.lax.scan(row, first, shifted.reshape(count, every))
    return jnp.concatenate([first[None], rows])


SPOT = 0.06  # m, side of one more patch


def _edge(steps: int, step: float) -> jnp.ndarray:
    """[steps, 6]: position, speed, acceleration of the plate's edge at times `k step`, each as (per unit speed, by pitching)."""
    slope = pushing.slopes(step, steps)
    rate = pushing.ramp(np.arange(steps) * step)
    travel = np.concatenate([[0.0], np.cumsum(pushing.ramp(np.arange(1, steps) * step)) * step])
    pitch, rate_p, slope_p = (pushing.PITCH_RATE * a for a in (travel, rate, slope))
    swing = pushing.EDGE_DROP * np.sin(pitch)
    swing_v = pushing.EDGE_DROP * np.cos(pitch) * rate_p
    swing_a = pushing.EDGE_DROP * (np.cos(pitch) * slope_p - np.sin(pitch) * rate_p**2)
    return jnp.asarray(np.stack([travel, swing, rate, swing_v, slope, swing_a], -1))
