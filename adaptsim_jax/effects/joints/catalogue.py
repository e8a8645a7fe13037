"""The effects that any joint of a machine may have, in the order in which searches ask for them.

What acts on the torque is a force here, since the torque of a joint may be made by an actuator's
own law from a command.
"""

from adaptsim_jax.effects.base import Effect, Quantity, Traits, of_the_engine
from adaptsim_jax.effects.joints import actuator, drives, forces, friction, sensor
from adaptsim_jax.effects.registry import of_other_packages

TILTS = ("about_x", "about_y")
ETA = (
    "size",
    "stretch_x",
    "stretch_y",
    "stretch_z",
    "shear_xy",
    "shear_xz",
    "shear_yz",
    "shift_x",
    "shift_y",
    "shift_z",
)
"""Parameters of a body: what its pseudo-inertia is multiplied by (`attribution/parameters.py`)."""
WIDEST = {name: (6.0 if name in ETA[:4] else 20.0) for name in ETA}

TILT = Effect(
    "tilt",
    "model",
    tuple(Quantity(name, "rad", -0.5, 0.5) for name in TILTS),
    of_the_engine,
    "gravity pulls along another direction: the base is not level",
    "wide angles under gravity",
    scope="base",
    formula="gravity turned about the world's x and y",
    traits=Traits(prior=0.03),
)

BODY = Effect(
    "inertia",
    "model",
    tuple(Quantity(name, "1", -wide, wide) for name, wide in WIDEST.items()),
    of_the_engine,
    "a body of another mass, centre of mass or moments than declared: a payload, another part",
    "fast motion, and wide angles under gravity",
    formula="the body's pseudo-inertia U U' becomes U V V' U'",
    traits=Traits(at_parents=True, fitted=True),
)

BODY_MASS = Effect(
    "body_mass",
    "model",
    (
        Quantity("mass", "kg", -1e3, 1e3),
        *(Quantity(f"moment_{axis}", "kg m", -1e3, 1e3) for axis in "xyz"),
    ),
    of_the_engine,
    "a body of another mass or centre of mass than declared: a payload, a tool, another part",
    "wide angles under gravity",
    (
        *("bias", "spring", "cogging", "tilt", "torque_gain", "torque_coupling"),
        *("encoder_offset", "encoder_scale", "inertia"),
    ),
    formula="mass and first moments more than the file's, the shape about the centre in proportion",
    traits=Traits(at_parents=True, in_balance=True),
)

OWN: tuple[Effect, ...] = (
    friction.VISCOUS,
    friction.COULOMB,
    friction.ASYMMETRIC_COULOMB,
    friction.STRIBECK,
    friction.PRESLIDING,
    friction.LOAD_FRICTION,
    friction.QUADRATIC_DRAG,
    forces.SPRING,
    forces.BIAS,
    forces.COGGING,
    forces.PERIODIC_DISTURBANCE,
    friction.FRICTION_DRIFT,
    forces.HARD_STOP,
    forces.ARMATURE,
    actuator.TORQUE_GAIN,
    forces.TORQUE_COUPLING,
    forces.FRICTION_COUPLING,
    actuator.POSITION_GAIN,
    actuator.SATURATION,
    actuator.DEAD_ZONE,
    actuator.DELAY,
    actuator.ACTUATOR_LAG,
    sensor.ENCODER_OFFSET,
    sensor.ENCODER_SCALE,
    sensor.SENSOR_DELAY,
    sensor.SENSOR_LAG,
    *forces.BY_ANGLE,
    *drives.DRIVES,
    sensor.BACKLASH,
    TILT,
    BODY,
    BODY_MASS,
)
MACHINE: tuple[Effect, ...] = (*OWN, *of_other_packages(taken=[e.name for e in OWN]))
