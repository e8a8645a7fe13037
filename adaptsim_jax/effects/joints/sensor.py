"""Between the motion of a joint and what its sensors say: `t, q, v: [T, ...]` have time first,
parameters `[1, ...]`.
"""

import jax
import jax.numpy as jnp

from adaptsim_jax.effects.base import Effect, Quantity, Traits
from adaptsim_jax.effects.joints.actuator import LATEST, lags


def encoder_offset(p, t, q, v, first):
    return q + p["offset"], v


def sensor_lag(p, t, q, v, first):
    """First-order filter of angle and velocity, exact for a velocity that is linear between rows.

    Both start as if the motion had gone on at its first acceleration, or velocity where a trial
    begins. A lag of 26 ms on a rig that accelerates by 50 rad/s^2 would otherwise start 34 mrad
    off.
    """
    lag = jnp.maximum(p["lag"], 1e-9)
    duration = jnp.diff(t, axis=0) * jnp.ones_like(q[1:])
    decay = jnp.exp(-duration / lag)
    slope = jnp.diff(v, axis=0) / jnp.where(duration > 0, duration, 1.0)
    slope = jnp.concatenate([slope, slope[-1:]])
    angle_error = _filter_error(v, jnp.where(t[0] > 0, slope[0], 0.0), duration, decay, lag)
    slope_lag = _filtered_slope(slope, decay)
    return q - angle_error * (p["lag"] / lag), v - p["lag"] * slope_lag


def _filter_error(v, slope, duration, decay, lag):
    """How far the filtered angle trails, e' = v - e / lag, for a velocity linear over each row."""
    step = lag * (1.0 - decay)
    ramp = jnp.where(duration > 0, lag - lag * step / jnp.where(duration > 0, duration, 1.0), 0.0)

    def row(error, row_values):
        v0, v1, decay, step, ramp = row_values
        error = error * decay + v0 * step + (v1 - v0) * ramp
        return error, error

    first = lag[0] * (v[0] - lag[0] * slope)
    _, errors = jax.lax.scan(row, first, (v[:-1], v[1:], decay, step, ramp))
    return jnp.concatenate([first[None], errors])


def _filtered_slope(slope, decay):
    """Filtered slope: a relaxation to the slope of each row."""

    def row(s, now):
        target, decay = now
        s = target + (s - target) * decay
        return s, s

    _, slopes = jax.lax.scan(row, slope[0], (slope[:-1], decay))
    return jnp.concatenate([slope[:1], slopes])


def _turning_angles(t, q, v):
    """Compute where the motion between rows turns back `[L, n, ...]`; the next row's `q` where it
    does not.
    """
    is_turning = v[:-1] * v[1:] < 0.0
    slowing = jnp.where(is_turning, v[:-1] - v[1:], 1.0)
    rest = jnp.diff(t, axis=0) * v[:-1] / slowing
    return jnp.where(is_turning, q[:-1] + 0.5 * v[:-1] * rest, q[1:])


def backlash(p, t, q, v, first):
    """Play between link and encoder: the reading follows the link at a distance of at most half the
    gap.

    A stretch begins with the reading that was measured, as near as the gap allows. The lost motion
    is taken up in the first half-gap of travel after each reversal (Nordin and Gutman, 2002, on the
    play operator and its rivals). A link that turns back between two rows was furthest where its
    speed, linear in between, was none.
    """
    half = 0.5 * p["gap"]

    def row(z, now):
        for at in now:
            z = jnp.clip(z, at - half[0], at + half[0])
        return z, z

    first = jnp.clip(first, q[0] - half[0], q[0] + half[0])
    _, rest = jax.lax.scan(row, first, (_turning_angles(t, q, v), q[1:]))
    reading = jnp.concatenate([first[None], rest])
    moving = jnp.abs(reading - q) >= 0.999 * half
    return reading, jnp.where(moving & ((q - reading) * v >= 0), v, 0.0 * v)


def sensor_delay(p, t, q, v, first):
    """Cubics between rows; before the first row the motion had gone on at its first
    acceleration.
    """
    shape = jnp.broadcast_shapes(jnp.shape(p["delay"]), q.shape, t.shape)

    def lanes(z):
        return jnp.broadcast_to(z, shape).reshape(shape[0], -1)

    q_late, v_late = jax.vmap(_at_times, 1, 1)(lanes(t), lanes(t - p["delay"]), lanes(q), lanes(v))
    return q_late.reshape(shape), v_late.reshape(shape)


def _at_times(t, at, q, v):
    """Angle and speed `[T]` at times `at [T]` between rows at `t [T]`."""
    k = jnp.clip(jnp.searchsorted(t, at, side="right") - 1, 0, len(t) - 2)
    span = jnp.where(t[k + 1] > t[k], t[k + 1] - t[k], 1.0)
    u, since = (at - t[k]) / span, at - t[k]
    rise = (v[k + 1] - v[k]) / span
    # what the mean of both speeds leaves of the way
    bend = q[k + 1] - q[k] - 0.5 * span * (v[k] + v[k + 1])
    inside = q[k] + since * (v[k] + 0.5 * rise * since)
    inside = inside + bend * u * u * (3.0 - 2.0 * u)
    before = q[0] + since * (v[0] + 0.5 * rise * since)
    return jnp.where(at < t[0], before, inside), v[k] + rise * since


def encoder_scale(p, t, q, v, first):
    return (1.0 + p["scale"]) * q, (1.0 + p["scale"]) * v


ENCODER_OFFSET = Effect(
    "encoder_offset",
    "measurement",
    (Quantity("offset", "rad", -0.8, 0.8, mjcf="ref"),),
    encoder_offset,
    "the encoder's zero is not the model's",
    "wide angles under gravity",
    ("bias", "tilt"),
    formula="reading = q + offset",
    traits=Traits(in_balance=True, at_parents=True, prior=0.03),
)

ENCODER_SCALE = Effect(
    "encoder_scale",
    "measurement",
    (Quantity("scale", "1", -0.5, 0.5, factor=True),),
    encoder_scale,
    "the reading is off by a share (a wrong gear ratio)",
    "wide angles under gravity",
    ("torque_gain",),
    formula="reading = (1 + scale) q",
    traits=Traits(in_balance=True, at_parents=True, prior=0.3),
)

SENSOR_DELAY = Effect(
    "sensor_delay",
    "measurement",
    (Quantity("delay", "s", 0.0, LATEST, sign=1),),
    sensor_delay,
    "the angles are logged late",
    "fast motion",
    ("delay", "sensor_lag"),
    formula="reading(t) = q(t - delay)",
    traits=Traits(shared=True),
)

SENSOR_LAG = Effect(
    "sensor_lag",
    "measurement",
    (Quantity("lag", "s", 0.0, 0.1, sign=1),),
    sensor_lag,
    "angle and speed come through a first-order filter",
    "fast motion",
    ("sensor_delay", "delay"),
    jump=True,
    grid=lags,
    formula="lag reading' = q - reading",
    traits=Traits(shared=True),
)


def _shares_of_range(reach, joint):
    span = float(reach.q_high[joint] - reach.q_low[joint])
    return [{"gap": share * span} for share in (0.01, 0.04, 0.15)]


BACKLASH = Effect(
    "backlash",
    "measurement",
    (Quantity("gap", "rad", 0.0, 0.4, sign=1),),
    backlash,
    "play between the link and what its encoder turns with",
    "many reversals",
    ("coulomb",),
    jump=True,
    slack="gap",
    grid=_shares_of_range,
    formula="reading follows q at a distance of at most gap / 2",
)
