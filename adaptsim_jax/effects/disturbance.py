"""What pushes a double pendulum from outside.

Torques repeat with the angle or with time. A base that does not stand still or level acts on all
joints at once, through the plant's gravity.
"""

import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core.trig import sin_cos
from adaptsim_jax.effects.base import Effect, Motion, Quantity

FINEST = 1.0 / 12.0  # Hz between frequencies of the grid: a trial of 6 s tells no more


def orders(reach, joint):
    return [{"order": float(k)} for k in range(2, 31)]


def frequencies(reach, joint):
    """Half a cycle of a trial apart, so that no frequency between two points goes unseen; at most
    half of Nyquist. In long trials no finer than `FINEST`.
    """
    top = min(15.0, 0.25 / reach.dt)
    step = max(0.5 / reach.duration, FINEST)
    return [{"frequency": float(f)} for f in np.arange(step, top, step)[:160]]


def bias(p, m: Motion):
    return p["torque"] + 0.0 * m.q


def cogging(p, m: Motion):
    sin, cos = sin_cos(p["order"] * m.q)
    return p["sine"] * sin + p["cosine"] * cos


def at_phase(p, m: Motion):
    """What goes on between trials, so that each trial meets it at another phase."""
    phase = 2.0 * jnp.pi * p["frequency"] * (m.t if m.clock is None else m.clock)
    sin, cos = sin_cos(phase)
    return p["sine"] * sin + p["cosine"] * cos


def periodic_disturbance(p, m: Motion):
    return at_phase(p, m) + 0.0 * m.q


PENDULUM_BIAS = Effect(
    "bias",
    "force",
    (Quantity("torque", "N m", -1.0, 1.0),),
    bias,
    "a constant torque: torque-sensor zero, cable pull, imbalance",
    "a wide range of angles",
    ("tilt", "encoder_offset", "spring"),
    formula="torque",
)

PENDULUM_COGGING = Effect(
    "cogging",
    "force",
    (
        Quantity("sine", "N m", -1.0, 1.0),
        Quantity("cosine", "N m", -1.0, 1.0),
        Quantity("order", "1", 2.0, 200.0, 7.0, shape=True, meaning="periods a turn"),
    ),
    cogging,
    "torque ripple periodic in the joint's angle (magnets, gear teeth)",
    "slow sweeps over many periods",
    ("spring",),
    formula="sine sin(order q) + cosine cos(order q)",
)

PENDULUM_PERIODIC_DISTURBANCE = Effect(
    "periodic_disturbance",
    "force",
    (
        Quantity("sine", "N m", -1.0, 1.0),
        Quantity("cosine", "N m", -1.0, 1.0),
        Quantity("frequency", "Hz", 0.05, 60.0, 2.0, shape=True),
    ),
    periodic_disturbance,
    "a torque periodic in time: a fan, mains, a neighbouring machine",
    "long trials whose commands leave that frequency free",
    ("cogging",),
    grid=frequencies,
    formula="sine sin(2 pi frequency t) + cosine cos(2 pi frequency t), t through all trials",
)


def _turned(m: Motion, angle):
    """Gravity `[n, ...]` as if the first joint stood further by `angle`."""
    shape = (m.q.shape[0],) + (1,) * (m.q.ndim - 1)
    first = jnp.zeros(shape, m.q.dtype).at[0].set(1.0)
    return m.gravity(m.q + angle * first)


def tilt(p, m: Motion):
    """The base turned by an angle."""
    return _turned(m, p["angle"]) - m.gravity(m.q)


def heave(p, m: Motion):
    """A base that moves up and down: what is felt as gravity swings about g."""
    return at_phase(p, m) * m.gravity(m.q)


def sway(p, m: Motion):
    """A base that moves to and fro: what is felt as gravity turns by the arctangent of its
    acceleration over g, and grows.
    """
    share = at_phase(p, m)
    return jnp.sqrt(1.0 + jnp.square(share)) * _turned(m, jnp.arctan(share)) - m.gravity(m.q)


def _shaken() -> tuple[Quantity, ...]:
    size = "of the base's acceleration, over g"
    return (
        Quantity("sine", "1", -1.0, 1.0, meaning=size),
        Quantity("cosine", "1", -1.0, 1.0, meaning=size),
        Quantity("frequency", "Hz", 0.05, 60.0, 2.0, shape=True),
    )


PENDULUM_TILT = Effect(
    "tilt",
    "force",
    (Quantity("angle", "rad", -0.8, 0.8),),
    tilt,
    "the base is not level: gravity pulls along another direction",
    "wide angles of joint 1, of both signs",
    ("bias", "encoder_offset"),
    scope="base",
    formula="gravity(q1 + angle) - gravity(q1), at both joints",
)

PENDULUM_HEAVE = Effect(
    "heave",
    "force",
    _shaken(),
    heave,
    "the base moves up and down periodically: a ship, a table on soft feet",
    "long trials at wide angles, where gravity pulls",
    ("sway", "periodic_disturbance"),
    scope="base",
    formula="a gravity(q), a = sine sin(2 pi frequency t) + cosine cos(2 pi frequency t), at both "
    "joints",
)

PENDULUM_SWAY = Effect(
    "sway",
    "force",
    _shaken(),
    sway,
    "the base moves to and fro periodically: a frame that swings along",
    "long trials through hanging and upright",
    ("heave", "periodic_disturbance"),
    scope="base",
    formula="sqrt(1 + a^2) gravity(q1 + atan a) - gravity(q1), a as of heave, at both joints",
)
