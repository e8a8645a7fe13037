"""Springs and end stops at a joint of a double pendulum."""

import jax.numpy as jnp

from adaptsim_jax.effects.base import Effect, Motion, Quantity

HERTZ_DEPTH = 0.1  # rad, at which stiffness is defined whatever the exponent


def stops(reach, joint):
    low, high = float(reach.q_low[joint]), float(reach.q_high[joint])
    span = high - low
    upper = [{"angle": high - span * s, "side": 1.0} for s in (0.03, 0.08, 0.15, 0.25, 0.4)]
    return upper + [{"angle": low + span * s, "side": -1.0} for s in (0.03, 0.08, 0.15, 0.25, 0.4)]


def spring(p, m: Motion):
    """A cubic about any angle, written about zero: a spring that hardens need not do so about the
    joint's zero.
    """
    linear = p["stiffness"] * m.q
    return p["preload"] - linear * (1.0 + p["bend"] * m.q + p["hardening"] * m.q**2)


def hard_stop(p, m: Motion):
    """A spring beyond an angle that never pulls: an upper stop where `side` is 1, a lower one where
    it is -1.

    It loses energy as a dashpot beside the spring (`damping`, Kelvin and Voigt), or in proportion
    to the depth (`loss`; Hunt and Crossley, 1975). A round contact is softer where it touches:
    `exponent` 1.5 is Hertz's, and the stiffness is then force over depth at `HERTZ_DEPTH`.
    """
    depth = jnp.maximum(p["side"] * (m.q - p["angle"]), 0.0)
    inward = p["side"] * m.v
    spring_like = depth * jnp.power(jnp.maximum(depth, 1e-6) / HERTZ_DEPTH, p["exponent"] - 1.0)
    pressed = spring_like * (1.0 + p["loss"] * inward) + jnp.where(
        depth > 0.0, p["damping"] * inward, 0.0
    )
    return -p["side"] * p["stiffness"] * jnp.maximum(pressed, 0.0)


PENDULUM_SPRING = Effect(
    "spring",
    "force",
    (
        Quantity("stiffness", "N m/rad", -5.0, 5.0, sign=1),
        Quantity("preload", "N m", -5.0, 5.0),
        Quantity(
            "bend", "1/rad", -5.0, 5.0, shape=True, optional=True, meaning="lopsidedness", late=True
        ),
        Quantity(
            "hardening",
            "1/rad^2",
            -5.0,
            5.0,
            shape=True,
            optional=True,
            meaning="cubic share",
            late=True,
        ),
    ),
    spring,
    "a torsional spring, or a cable that pulls back; at rest at preload / stiffness",
    "a wide range of angles",
    ("bias", "tilt", "encoder_offset", "hard_stop"),
    contains=("bias",),
    formula="preload - stiffness q (1 + bend q + hardening q^2)",
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
        Quantity(
            "damping",
            "s",
            0.0,
            0.5,
            shape=True,
            optional=True,
            meaning="a dashpot beside the spring, over its stiffness",
        ),
        Quantity(
            "exponent",
            "1",
            0.7,
            2.5,
            1.0,
            shape=True,
            optional=True,
            meaning="of depth; 1.5 is Hertz's",
            late=True,
        ),
    ),
    hard_stop,
    "an end stop or a taut cable beyond an angle",
    "motion into the stop, and well inside it",
    ("spring", "cogging"),
    smooth=False,
    formula="-side stiffness max(0, depth^exponent (1 + loss depth') + damping depth'), depth = "
    "max(0, side (q - angle))",
)
