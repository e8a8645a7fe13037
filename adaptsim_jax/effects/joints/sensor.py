"""Between the motion of a joint of any machine and what its sensors say."""

import jax
import jax.numpy as jnp

from adaptsim_jax.effects.base import Effect, Parameter, Traits
from adaptsim_jax.effects.joints.actuator import LATEST, lags
from adaptsim_jax.effects.sensor import backlash, encoder_offset, sensor_lag


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
    bend = (
        q[k + 1] - q[k] - 0.5 * span * (v[k] + v[k + 1])
    )  # what the mean of both speeds leaves of the way
    inside = q[k] + since * (v[k] + 0.5 * rise * since) + bend * u * u * (3.0 - 2.0 * u)
    before = q[0] + since * (v[0] + 0.5 * rise * since)
    return jnp.where(at < t[0], before, inside), v[k] + rise * since


def encoder_scale(p, t, q, v, first):
    return (1.0 + p["scale"]) * q, (1.0 + p["scale"]) * v


ENCODER_OFFSET = Effect(
    "encoder_offset",
    "measurement",
    (Parameter("offset", "rad", -0.8, 0.8, 0.0),),
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
    (Parameter("scale", "1", -0.5, 0.5, 0.0, factor=True),),
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
    (Parameter("delay", "s", 0.0, LATEST, 0.0, sign=1),),
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
    (Parameter("lag", "s", 0.0, 0.1, 0.0, sign=1),),
    sensor_lag,
    "angle and speed come through a first-order filter",
    "fast motion",
    ("sensor_delay", "delay"),
    jump=True,
    grid=lags,
    formula="lag reading' = q - reading",
    traits=Traits(shared=True),
)

BACKLASH = Effect(
    "backlash",
    "measurement",
    (Parameter("gap", "rad", 0.0, 0.4, 0.0, sign=1),),
    backlash,
    "play between the link and what its encoder turns with",
    "many reversals",
    ("coulomb",),
    jump=True,
    slack="gap",
    grid=lambda reach, joint: [
        {"gap": g * float(reach.q_high[joint] - reach.q_low[joint])} for g in (0.01, 0.04, 0.15)
    ],
    formula="reading follows q at a distance of at most gap / 2",
)
