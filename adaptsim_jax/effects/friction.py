"""Friction and drag at a joint."""

import jax.numpy as jnp

from adaptsim_jax.effects import grids
from adaptsim_jax.effects.base import Dry, Effect, Motion, Parameter, Relaxation

WIDTH = Parameter(
    "width",
    "rad/s",
    0.0,
    0.2,
    0.0,
    None,
    optional=True,
    meaning="within which it turns; 0 is sharp",
    late=True,
)


def coulomb(p, m: Motion):
    return Dry(p["level"] + 0.0 * m.q, width=p["width"])


def stribeck(p, m: Motion):
    """Bo and Pavelescu's (1982) Gaussian fall from break-away to sliding friction."""
    return Dry(p["level"] + p["excess"] * jnp.exp(-jnp.square(m.v / p["speed"])), width=p["width"])


def quadratic_drag(p, m: Motion):
    return -p["drag"] * m.v * jnp.abs(m.v)


def friction_drift(p, m: Motion):
    """Friction that is there when the trial begins and fades as the joint warms."""
    fade = jnp.exp(-m.t / p["decay"])
    return Dry(p["dry"] * fade + 0.0 * m.q, -p["viscous"] * fade * m.v)


def load_friction(p, m: Motion):
    return Dry(p["share"] * jnp.abs(m.u), width=p["width"])


def presliding(p, m: Motion):
    """Dahl (1968): a bristle bends before the joint slides; memory is its deflection over the
    break-away deflection. With damping it is LuGre (Canudas de Wit et al., 1995): the bristle's
    rate resists too.
    """
    speed = jnp.abs(m.v)
    rate = (m.v - speed * m.memory) / p["deflection"]
    force = -p["level"] * (m.memory + p["damping"] * rate)
    return Relaxation(force, m.v / jnp.sqrt(speed**2 + 1e-12), speed / p["deflection"])


COULOMB = Effect(
    "coulomb",
    "force",
    (Parameter("level", "N m", 0.0, 1.0, 0.0, sign=1), WIDTH),
    coulomb,
    "dry friction: a constant torque against the motion",
    "reversals, and both slow and fast motion",
    ("stribeck", "presliding", "load_friction", "dead_zone", "friction_drift"),
    formula="-level sign(v), or tanh(v / width); holds the joint where less than the level would "
    "move it",
    title="Coulomb friction",
)

STRIBECK = Effect(
    "stribeck",
    "force",
    (
        Parameter("level", "N m", 0.0, 1.0, 0.0, sign=1),
        Parameter("excess", "N m", 0.0, 2.0, 0.0, sign=1, meaning="how much more at rest"),
        Parameter(
            "speed",
            "rad/s",
            0.02,
            20.0,
            0.5,
            None,
            meaning="at which the excess has fallen to a third",
        ),
        WIDTH,
    ),
    stribeck,
    "dry friction that is higher at creeping speed",
    "long stretches of slow motion beside fast ones",
    ("coulomb", "presliding"),
    contains=("coulomb",),
    grid=grids.speeds,
    formula="-(level + excess exp(-(v / speed)^2)) sign(v), or tanh(v / width)",
    title="Stribeck friction",
)

QUADRATIC_DRAG = Effect(
    "quadratic_drag",
    "force",
    (Parameter("drag", "N m s^2/rad^2", 0.0, 1.0, 0.0, sign=1),),
    quadratic_drag,
    "air drag or turbulent oil: torque with the square of speed",
    "a wide range of speeds",
    ("coulomb", "friction_drift"),
    formula="-drag v |v|",
)

FRICTION_DRIFT = Effect(
    "friction_drift",
    "force",
    (
        Parameter("viscous", "N m s/rad", -1.0, 1.0, 0.0),
        Parameter("dry", "N m", -1.0, 1.0, 0.0),
        Parameter("decay", "s", 0.05, 100.0, 2.0, None, meaning="time to fall to a third"),
    ),
    friction_drift,
    "friction that changes as the joint warms up within a trial",
    "the same motion early and late in a trial",
    ("coulomb", "quadratic_drag"),
    grid=grids.decays,
    formula="-(dry sign(v) + viscous v) exp(-t / decay), t since the trial began",
)

LOAD_FRICTION = Effect(
    "load_friction",
    "force",
    (Parameter("share", "1", 0.0, 1.0, 0.0, sign=1), WIDTH),
    load_friction,
    "gear friction in proportion to the torque that the joint carries",
    "high and low torque at like speeds",
    ("coulomb", "torque_gain"),
    formula="-share |command| sign(v), or tanh(v / width)",
    title="load-dependent friction",
)

PRESLIDING = Effect(
    "presliding",
    "force",
    (
        Parameter("level", "N m", 0.0, 1.0, 0.0, sign=1),
        Parameter("deflection", "rad", 1e-3, 0.5, 0.02, None, meaning="at which it breaks away"),
        Parameter(
            "damping", "s", 0.0, 0.1, 0.0, None, meaning="of the bristle; 0 is Dahl, more is LuGre"
        ),
    ),
    presliding,
    "friction that acts as a spring before the joint slides (Dahl, LuGre)",
    "many small reversals of less than the break-away deflection",
    ("coulomb", "stribeck", "backlash"),
    memory=True,
    smooth=False,
    contains=("coulomb",),
    grid=grids.deflections,
    formula="-level (z + damping z'), z' = (v - |v| z) / deflection",
)
