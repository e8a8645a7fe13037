"""Friction and drag at a joint: of the double pendulum, then of any machine."""

from dataclasses import replace

import jax.numpy as jnp

from adaptsim_jax.effects.base import Dry, Effect, Motion, Quantity, Relaxation, Traits


def speeds(reach, joint):
    top = float(reach.speed[joint])
    return [{"speed": top * s} for s in (0.05, 0.1, 0.2, 0.4)]


def decays(reach, joint):
    return [{"decay": reach.duration * s} for s in (0.1, 0.2, 0.4, 1.0)]


def coulomb(p, m: Motion):
    return Dry(p["level"] + 0.0 * m.q)


def stribeck_and_level(p, m: Motion):
    """Bo and Pavelescu's (1982) Gaussian fall from break-away to sliding friction."""
    return Dry(p["level"] + p["excess"] * jnp.exp(-jnp.square(m.v / p["speed"])))


def quadratic_drag(p, m: Motion):
    return -p["drag"] * m.v * jnp.abs(m.v)


def friction_drift(p, m: Motion):
    """Friction that is there when the trial begins and fades as the joint warms."""
    fade = jnp.exp(-m.t / p["decay"])
    return Dry(p["dry"] * fade + 0.0 * m.q, -p["viscous"] * fade * m.v)


def load_friction(p, m: Motion):
    return Dry(p["share"] * jnp.abs(m.u))


def bristle(p, m: Motion):
    """Dahl (1968): a bristle bends before the joint slides; memory is its deflection over the
    break-away deflection. With damping it is LuGre (Canudas de Wit et al., 1995): the bristle's
    rate resists too.
    """
    speed = jnp.abs(m.v)
    rate = (m.v - speed * m.memory) / p["deflection"]
    force = -p["level"] * (m.memory + p["damping"] * rate)
    return Relaxation(force, m.v / jnp.sqrt(speed**2 + 1e-12), speed / p["deflection"])


PENDULUM_COULOMB = Effect(
    "coulomb",
    "force",
    (Quantity("level", "N m", 0.0, 1.0, sign=1),),
    coulomb,
    "dry friction: a constant torque against the motion",
    "reversals, and both slow and fast motion",
    ("stribeck", "presliding", "load_friction", "dead_zone", "friction_drift"),
    formula="-level sign(v); holds the joint where less than the level would move it",
    title="Coulomb friction",
)

PENDULUM_STRIBECK = Effect(
    "stribeck",
    "force",
    (
        Quantity("level", "N m", 0.0, 1.0, sign=1),
        Quantity("excess", "N m", 0.0, 2.0, sign=1, meaning="how much more at rest"),
        Quantity(
            "speed",
            "rad/s",
            0.02,
            20.0,
            0.5,
            shape=True,
            meaning="at which the excess has fallen to a third",
        ),
    ),
    stribeck_and_level,
    "dry friction that is higher at creeping speed",
    "long stretches of slow motion beside fast ones",
    ("coulomb", "presliding"),
    contains=("coulomb",),
    formula="-(level + excess exp(-(v / speed)^2)) sign(v)",
    title="Stribeck friction",
)

PENDULUM_QUADRATIC_DRAG = Effect(
    "quadratic_drag",
    "force",
    (Quantity("drag", "N m s^2/rad^2", 0.0, 1.0, sign=1),),
    quadratic_drag,
    "air drag or turbulent oil: torque with the square of speed",
    "a wide range of speeds",
    ("coulomb", "friction_drift"),
    formula="-drag v |v|",
)

PENDULUM_FRICTION_DRIFT = Effect(
    "friction_drift",
    "force",
    (
        Quantity("viscous", "N m s/rad", -1.0, 1.0),
        Quantity("dry", "N m", -1.0, 1.0),
        Quantity("decay", "s", 0.05, 100.0, 2.0, shape=True, meaning="time to fall to a third"),
    ),
    friction_drift,
    "friction that changes as the joint warms up within a trial",
    "the same motion early and late in a trial",
    ("coulomb", "quadratic_drag"),
    grid=decays,
    formula="-(dry sign(v) + viscous v) exp(-t / decay), t since the trial began",
)

PENDULUM_LOAD_FRICTION = Effect(
    "load_friction",
    "force",
    (Quantity("share", "1", 0.0, 1.0, sign=1),),
    load_friction,
    "gear friction in proportion to the torque that the joint carries",
    "high and low torque at like speeds",
    ("coulomb", "torque_gain"),
    formula="-share |command| sign(v)",
    title="load-dependent friction",
)

PENDULUM_PRESLIDING = Effect(
    "presliding",
    "force",
    (
        Quantity("level", "N m", 0.0, 1.0, sign=1),
        Quantity(
            "deflection", "rad", 1e-3, 0.5, 0.02, shape=True, meaning="at which it breaks away"
        ),
        Quantity(
            "damping", "s", 0.0, 0.1, shape=True, meaning="of the bristle; 0 is Dahl, more is LuGre"
        ),
    ),
    bristle,
    "friction that acts as a spring before the joint slides (Dahl, LuGre)",
    "many small reversals of less than the break-away deflection",
    ("coulomb", "stribeck", "backlash"),
    memory=True,
    smooth=False,
    contains=("coulomb",),
    formula="-level (z + damping z'), z' = (v - |v| z) / deflection",
)


def viscous(p, m):
    return -p["damping"] * m.v


def asymmetric(p, m):
    """Half the difference of the levels of dry friction up and down; beside `coulomb`, which has
    their mean.
    """
    return Dry(p["difference"] * jnp.where(m.v >= 0.0, 1.0, -1.0))


def stribeck(p, m):
    return Dry(p["excess"] * jnp.exp(-jnp.square(m.v / p["speed"])))


def presliding(p, m):
    """Bristles that bend before the joint slides (Dahl, 1968; the integrator has their state).
    Their own damping, which LuGre's model (Canudas de Wit et al., 1995) adds, is not modelled.
    """
    return Dry(0.0 * m.q, yielding=p["compliance"] + 0.0 * m.q)


def _bristles(reach, joint):
    """Compliances with which friction of a tenth of the torque breaks away after these shares of
    the range of motion.
    """
    span = float(reach.q_high[joint] - reach.q_low[joint])
    return [
        {"compliance": s * span / (0.1 * float(reach.torque[joint]))}
        for s in (0.001, 0.003, 0.01, 0.03, 0.1)
    ]


VISCOUS = Effect(
    "viscous",
    "force",
    (Quantity("damping", "N m s/rad", 0.0, 10.0, sign=1, mjcf="damping"),),
    viscous,
    "friction in proportion to the speed",
    "fast motion",
    ("quadratic_drag", "coulomb"),
    formula="-damping v",
    traits=Traits(fitted=True, resists=True),
)

COULOMB = Effect(
    "coulomb",
    "force",
    (Quantity("level", "N m", 0.0, 2.0, sign=1, mjcf="frictionloss"),),
    coulomb,
    "dry friction: a constant torque against the motion",
    "reversals, and both slow and fast motion",
    ("stribeck", "load_friction", "asymmetric_coulomb"),
    formula="-level sign(v); holds the joint where less than the level would move it",
    traits=Traits(family=True, tried_first=2, resists=True),
    title="Coulomb friction",
)

ASYMMETRIC_COULOMB = Effect(
    "asymmetric_coulomb",
    "force",
    (Quantity("difference", "N m", -1.0, 1.0),),
    asymmetric,
    "dry friction of another level in each direction",
    "both directions at like speeds",
    ("coulomb", "bias"),
    formula="-difference: half of what friction upwards is more than downwards",
    traits=Traits(resists=True),
    title="asymmetric Coulomb",
)

STRIBECK = Effect(
    "stribeck",
    "force",
    (
        Quantity("excess", "N m", 0.0, 2.0, sign=1),
        Quantity(
            "speed",
            "rad/s",
            0.005,
            20.0,
            0.5,
            shape=True,
            meaning="at which the excess has fallen to a third",
        ),
    ),
    stribeck,
    "dry friction that is higher at creeping speed (Bo and Pavelescu, 1982)",
    "long stretches of slow motion beside fast ones",
    ("coulomb", "load_friction"),
    grid=speeds,
    formula="-excess exp(-(v / speed)^2) sign(v), beside what is there at speed",
    traits=Traits(resists=True),
    title="Stribeck friction",
)

PRESLIDING = Effect(
    "presliding",
    "force",
    (Quantity("compliance", "rad/(N m)", 0.0, 5.0, sign=1),),
    presliding,
    "dry friction that gives way as a spring before the joint slides (Dahl, 1968; LuGre)",
    "many small reversals",
    ("coulomb", "stribeck", "backlash"),
    jump=True,
    grid=_bristles,
    formula="what dry friction there is builds up as deflection / compliance",
    traits=Traits(in_balance=False),
)

LOAD_FRICTION = Effect(
    "load_friction",
    "force",
    (Quantity("share", "1", 0.0, 3.0, sign=1),),
    load_friction,
    "dry friction that grows with the torque that the joint carries",
    "high and low torque at like speeds",
    ("coulomb", "stribeck", "torque_gain"),
    formula="-share |torque| sign(v), beside what is there without load",
    traits=Traits(on_actuator=True, family=True, resists=True),
    title="load-dependent friction",
)

QUADRATIC_DRAG = replace(
    PENDULUM_QUADRATIC_DRAG,
    parameters=(Quantity("drag", "N m s^2/rad^2", 0.0, 2.0, sign=1, mjcf="drag"),),
    look_alikes=("viscous", "coulomb"),
    traits=Traits(family=True, resists=True),
)

FRICTION_DRIFT = replace(PENDULUM_FRICTION_DRIFT, traits=Traits(in_balance=False))
