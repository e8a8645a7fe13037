"""Effects of a base that does not stand still or level: they act on all joints at once, through the
plant's gravity.
"""

import jax.numpy as jnp

from adaptsim_jax.effects.base import Effect, Motion, Parameter
from adaptsim_jax.effects.disturbance import at_phase
from adaptsim_jax.effects.grids import frequencies


def _turned(m: Motion, angle):
    """Gravity `[n, ...]` as if the first joint stood further by `angle`."""
    first = jnp.zeros((m.q.shape[0],) + (1,) * (m.q.ndim - 1), m.q.dtype).at[0].set(1.0)
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


def _shaken() -> tuple[Parameter, ...]:
    size = "of the base's acceleration, over g"
    return (
        Parameter("sine", "1", -1.0, 1.0, 0.0, meaning=size),
        Parameter("cosine", "1", -1.0, 1.0, 0.0, meaning=size),
        Parameter("frequency", "Hz", 0.05, 60.0, 2.0, None),
    )


TILT = Effect(
    "tilt",
    "force",
    (Parameter("angle", "rad", -0.8, 0.8, 0.0),),
    tilt,
    "the base is not level: gravity pulls along another direction",
    "wide angles of joint 1, of both signs",
    ("bias", "encoder_offset"),
    scope="base",
    formula="gravity(q1 + angle) - gravity(q1), at both joints",
)

HEAVE = Effect(
    "heave",
    "force",
    _shaken(),
    heave,
    "the base moves up and down periodically: a ship, a table on soft feet",
    "long trials at wide angles, where gravity pulls",
    ("sway", "periodic_disturbance"),
    scope="base",
    grid=frequencies,
    formula="a gravity(q), a = sine sin(2 pi frequency t) + cosine cos(2 pi frequency t), at both "
    "joints",
)

SWAY = Effect(
    "sway",
    "force",
    _shaken(),
    sway,
    "the base moves to and fro periodically: a frame that swings along",
    "long trials through hanging and upright",
    ("heave", "periodic_disturbance"),
    scope="base",
    grid=frequencies,
    formula="sqrt(1 + a^2) gravity(q1 + atan a) - gravity(q1), a as of heave, at both joints",
)
