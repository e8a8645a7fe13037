"""Effects between the true motion and what the sensors say: `t, q, v: [T, ...]` with time first,
parameters `[1, ...]`.
"""

import jax
import jax.numpy as jnp

from adaptsim_jax.effects.base import Effect, Parameter


def encoder_offset(p, t, q, v, first):
    return q + p["offset"], v


def sensor_lag(p, t, q, v, first):
    """First-order filter of angle and velocity, which start as if the motion had gone on at its
    first acceleration (a lag of 26 ms on a rig that accelerates by 50 rad/s^2 would otherwise start
    34 mrad off), or velocity where a trial begins.

    Between rows the velocity is taken to change linearly, for which the filter is exact.
    """
    lag = jnp.maximum(p["lag"], 1e-9)
    duration = jnp.diff(t, axis=0) * jnp.ones_like(q[1:])
    keep = jnp.exp(-duration / lag)
    slope = jnp.diff(v, axis=0) / jnp.where(duration > 0, duration, 1.0)
    slope = jnp.concatenate([slope, slope[-1:]])
    behind = _behind(v, jnp.where(t[0] > 0, slope[0], 0.0), duration, keep, lag)
    late = _behind_slope(slope, keep)
    return q - behind * (p["lag"] / lag), v - p["lag"] * late


def _behind(v, slope, duration, keep, lag):
    """How far the filtered angle trails, e' = v - e / lag, for a velocity linear over each row."""
    step = lag * (1.0 - keep)
    ramp = jnp.where(duration > 0, lag - lag * step / jnp.where(duration > 0, duration, 1.0), 0.0)

    def row(e, now):
        v0, v1, keep, step, ramp = now
        e = e * keep + v0 * step + (v1 - v0) * ramp
        return e, e

    first = lag[0] * (v[0] - lag[0] * slope)
    _, rest = jax.lax.scan(row, first, (v[:-1], v[1:], keep, step, ramp))
    return jnp.concatenate([first[None], rest])


def _behind_slope(slope, keep):
    """Filtered slope: a relaxation to the slope of each row."""

    def row(s, now):
        target, keep = now
        s = target + (s - target) * keep
        return s, s

    _, rest = jax.lax.scan(row, slope[0], (slope[:-1], keep))
    return jnp.concatenate([slope[:1], rest])


def _turning(t, q, v):
    """Where the motion between rows turns back `[L, n, ...]`; the next row's `q` where it does
    not.
    """
    turns = v[:-1] * v[1:] < 0.0
    slowing = jnp.where(turns, v[:-1] - v[1:], 1.0)
    rest = jnp.diff(t, axis=0) * v[:-1] / slowing
    return jnp.where(turns, q[:-1] + 0.5 * v[:-1] * rest, q[1:])


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
    _, rest = jax.lax.scan(row, first, (_turning(t, q, v), q[1:]))
    reading = jnp.concatenate([first[None], rest])
    moving = jnp.abs(reading - q) >= 0.999 * half
    return reading, jnp.where(moving & ((q - reading) * v >= 0), v, 0.0 * v)


def _lags(reach, joint):
    return [{"lag": s} for s in (0.002, 0.005, 0.01, 0.02, 0.04)]


def _gaps(reach, joint):
    span = float(reach.q_high[joint] - reach.q_low[joint])
    return [{"gap": g} for g in (0.003, 0.01, 0.03, 0.1) if g < 0.5 * span] or [
        {"gap": 0.1 * span + 1e-4}
    ]


ENCODER_OFFSET = Effect(
    "encoder_offset",
    "measurement",
    (Parameter("offset", "rad", -0.8, 0.8, 0.0),),
    encoder_offset,
    "the encoder's zero is not the model's",
    "wide angles, so that gravity tells the true zero",
    ("tilt", "bias"),
    formula="reading = q + offset",
)

SENSOR_LAG = Effect(
    "sensor_lag",
    "measurement",
    (Parameter("lag", "s", 0.0, 0.1, 0.0, sign=1),),
    sensor_lag,
    "angle and velocity come through a first-order filter",
    "fast motion",
    ("delay", "actuator_lag"),
    jump=True,
    grid=_lags,
    formula="lag reading' = q - reading, of angle and velocity",
)

BACKLASH = Effect(
    "backlash",
    "measurement",
    (Parameter("gap", "rad", 0.0, 0.4, 0.0, sign=1),),
    backlash,
    "play between the link and what its encoder turns with",
    "many reversals, slow and fast",
    ("presliding",),
    smooth=False,
    jump=True,
    grid=_gaps,
    formula="reading follows q at a distance of at most gap / 2",
)
