"""Inertia that a mechanism's parameters do not hold."""

from adaptsim_jax.effects.base import Effect, Parameter


def rotor_inertia(p):
    return p["inertia"]


ROTOR_INERTIA = Effect(
    "rotor_inertia",
    "force",
    (Parameter("inertia", "kg m^2", 0.0, 1.0, 0.0, sign=1),),
    rotor_inertia,
    "the motor's inertia times gear ratio squared, felt at its own joint only (large ratio: the "
    "coupling through "
    "the moving stator is smaller by the ratio and left out); at joint 1 a rigid body's own "
    "inertia absorbs it",
    "fast motion of both joints with the elbow straight and bent",
    ("torque_gain",),
    inertia=True,
    formula="-inertia dv/dt, of its own joint only",
)
