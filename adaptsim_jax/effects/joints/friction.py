"""Friction and drag at a joint of any machine."""

import jax.numpy as jnp

from adaptsim_jax.effects import friction, grids
from adaptsim_jax.effects.base import Dry, Effect, Parameter, Traits


def viscous(p, m):
    return -p["damping"] * m.v


def coulomb(p, m):
    return Dry(p["level"] + 0.0 * m.q)


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


def load_friction(p, m):
    return Dry(p["share"] * jnp.abs(m.u))


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
    (Parameter("damping", "N m s/rad", 0.0, 10.0, 0.0, sign=1, mjcf="damping"),),
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
    (Parameter("level", "N m", 0.0, 2.0, 0.0, sign=1, mjcf="frictionloss"),),
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
    (Parameter("difference", "N m", -1.0, 1.0, 0.0),),
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
        Parameter("excess", "N m", 0.0, 2.0, 0.0, sign=1),
        Parameter(
            "speed",
            "rad/s",
            0.005,
            20.0,
            0.5,
            None,
            meaning="at which the excess has fallen to a third",
        ),
    ),
    stribeck,
    "dry friction that is higher at creeping speed (Bo and Pavelescu, 1982)",
    "long stretches of slow motion beside fast ones",
    ("coulomb", "load_friction"),
    grid=grids.speeds,
    formula="-excess exp(-(v / speed)^2) sign(v), beside what is there at speed",
    traits=Traits(resists=True),
    title="Stribeck friction",
)

PRESLIDING = Effect(
    "presliding",
    "force",
    (Parameter("compliance", "rad/(N m)", 0.0, 5.0, 0.0, sign=1),),
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
    (Parameter("share", "1", 0.0, 3.0, 0.0, sign=1),),
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
    (Parameter("drag", "N m s^2/rad^2", 0.0, 2.0, 0.0, sign=1),),
    friction.quadratic_drag,
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
        Parameter("viscous", "N m s/rad", -1.0, 1.0, 0.0),
        Parameter("dry", "N m", -1.0, 1.0, 0.0),
        Parameter("decay", "s", 0.05, 100.0, 2.0, None, meaning="time to fall to a third"),
    ),
    friction.friction_drift,
    "friction that changes as the joint warms up within a trial",
    "the same motion early and late in a trial",
    ("coulomb", "quadratic_drag"),
    grid=grids.decays,
    formula="-(dry sign(v) + viscous v) exp(-t / decay), t since the trial began",
    traits=Traits(in_balance=False),
)
