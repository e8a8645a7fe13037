"""Springs and end stops at a joint of a double pendulum."""

import jax.numpy as jnp

from adaptsim_jax.effects.base import Effect, Motion, Quantity


def stops(reach, joint):
    low, high = float(reach.q_low[joint]), float(reach.q_high[joint])
    span = high - low
    upper = [{"angle": high - span * s, "side": 1.0} for s in (0.03, 0.08, 0.15, 0.25, 0.4)]
    return upper + [{"angle": low + span * s, "side": -1.0} for s in (0.03, 0.08, 0.15, 0.25, 0.4)]


def spring(p, m: Motion):
    return p["preload"] - p["stiffness"] * m.q


def hard_stop(p, m: Motion):
    """A spring beyond an angle that never pulls: an upper stop where `side` is 1, a lower one where
    it is -1.

    It loses energy in proportion to the depth (`loss`; Hunt and Crossley, 1975).
    """
    depth = jnp.maximum(p["side"] * (m.q - p["angle"]), 0.0)
    pressed = depth * (1.0 + p["loss"] * p["side"] * m.v)
    return -p["side"] * p["stiffness"] * jnp.maximum(pressed, 0.0)


PENDULUM_SPRING = Effect(
    "spring",
    "force",
    (
        Quantity("stiffness", "N m/rad", -5.0, 5.0, sign=1),
        Quantity("preload", "N m", -5.0, 5.0),
    ),
    spring,
    "a torsional spring, or a cable that pulls back; at rest at preload / stiffness",
    "a wide range of angles",
    ("bias", "tilt", "encoder_offset", "hard_stop"),
    contains=("bias",),
    formula="preload - stiffness q",
    title="torsional spring",
)

PENDULUM_HARD_STOP = Effect(
    "hard_stop",
    "force",
    (
        Quantity("stiffness", "N m/rad", 0.0, 300.0, sign=1),
        Quantity("angle", "rad", -100.0, 100.0, 1.5, shape=True),
        Quantity(
            "side",
            "1",
            -1.0,
            1.0,
            1.0,
            shape=True,
            held=True,
            meaning="1: stops motion upwards, -1: downwards",
        ),
        Quantity(
            "loss",
            "s",
            0.0,
            1.0,
            shape=True,
            optional=True,
            meaning="energy lost in proportion to depth",
        ),
    ),
    hard_stop,
    "an end stop or a taut cable beyond an angle",
    "motion into the stop, and well inside it",
    ("spring", "cogging"),
    smooth=False,
    formula="-side stiffness max(0, side (q - angle)) (1 + loss depth')",
)
