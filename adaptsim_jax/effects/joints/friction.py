"""Friction and drag at a joint of any machine."""

import jax.numpy as jnp

from adaptsim_jax.effects.base import Dry, Effect, Motion, Quantity, Traits


def speed_grid(reach, joint):
    top = float(reach.speed[joint])
    return [{"speed": top * s} for s in (0.05, 0.1, 0.2, 0.4)]


def decay_grid(reach, joint):
    return [{"decay": reach.duration * s} for s in (0.1, 0.2, 0.4, 1.0)]


def coulomb(p, m: Motion):
    return Dry(p["level"] + 0.0 * m.q)


def quadratic_drag(p, m: Motion):
    return -p["drag"] * m.v * jnp.abs(m.v)


def friction_drift(p, m: Motion):
    """Friction that is there when the trial begins and fades as the joint warms."""
    fade = jnp.exp(-m.t / p["decay"])
    return Dry(p["dry"] * fade + 0.0 * m.q, -p["viscous"] * fade * m.v)


def load_friction(p, m: Motion):
    return Dry(p["share"] * jnp.abs(m.u))


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


def _compliance_grid(reach, joint):
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
    grid=speed_grid,
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
    grid=_compliance_grid,
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

QUADRATIC_DRAG = Effect(
    "quadratic_drag",
    "force",
    (Quantity("drag", "N m s^2/rad^2", 0.0, 2.0, sign=1, mjcf="drag"),),
    quadratic_drag,
    "air drag or turbulent oil: torque with the square of speed",
    "a wide range of speeds",
    ("viscous", "coulomb"),
    formula="-drag v |v|",
    traits=Traits(family=True, resists=True),
)

FRICTION_DRIFT = Effect(
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
    grid=decay_grid,
    formula="-(dry sign(v) + viscous v) exp(-t / decay), t since the trial began",
    traits=Traits(in_balance=False),
)
