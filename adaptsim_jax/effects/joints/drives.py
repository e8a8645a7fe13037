"""The drive between an actuator and its joint: how it winds up, and its play.

As an encoder on the motor's side has it far below the resonance, where the torque decides. And
at any speed, with the rotor's own motion, where the joint has an armature
(`attribution/drive.py`).
"""

import jax.numpy as jnp
import numpy as np

from adaptsim_jax.effects.base import Drive, Effect, Quantity

ENCODERS = ((0.0, 0.0), (1.0, 1.0), (1.0, 0.0))  # on the link's side: the log's, the controller's
SIDES = (
    Quantity(
        "link",
        "1",
        0.0,
        1.0,
        shape=True,
        held=True,
        meaning="1: the logged encoder is on the link's side, 0: on the rotor's",
    ),
    Quantity(
        "control",
        "1",
        0.0,
        1.0,
        shape=True,
        held=True,
        optional=True,
        meaning="the same of the controller's encoder",
    ),
)
DASHPOT = Quantity(
    "damping",
    "s",
    0.0,
    0.5,
    0.01,
    shape=True,
    meaning="a dashpot beside the spring, over its stiffness",
)


def drive_compliance(p, t, q, v, first, torque):
    """The encoder is on the motor's side of a drive that winds up. Inertia of the motor beyond the
    spring is not modelled: below the resonance of motor and spring.
    """
    deflection = p["compliance"] * torque
    return q + deflection, v + _rate(deflection, t)


def drive_play(p, t, q, v, first, torque):
    """Play in a drive, with the encoder on the motor's side.

    The motor lies against the side towards which it pulls, and crosses at once where the torque
    turns. Its own inertia is not modelled.
    """
    side = jnp.clip(torque / jnp.maximum(p["width"], 1e-12), -1.0, 1.0)
    return q + 0.5 * p["gap"] * side, v + 0.5 * p["gap"] * _rate(side, t)


def drive_elasticity(p):
    return Drive(p["compliance"], p["damping"], 0.0 * p["compliance"], p["link"], p["control"])


def drive_backlash(p):
    return Drive(p["compliance"], p["damping"], p["gap"], p["link"], p["control"])


def _rate(z, t):
    """Rate of change of z [T, ...] by differences over two rows."""
    dt = t[2:] - t[:-2]
    rate = (z[2:] - z[:-2]) / jnp.where(dt > 0, dt, 1.0)
    return jnp.concatenate([rate[:1], jnp.where(dt > 0, rate, 0.0), rate[-1:]])


def _play_widths(reach, joint):
    return [{"width": float(reach.torque[joint]) * s} for s in (0.01, 0.05, 0.2)]


def _resonant_drive(reach, joint, hertz, damping):
    """Compliances and dashpots of drives whose rotor, a third of the joint's inertia, swings so
    fast against the link.
    """
    angular_frequency = 2.0 * np.pi * hertz
    return {
        "compliance": 4.5 / (float(reach.inertia[joint]) * angular_frequency**2),
        "damping": 2.0 * damping / angular_frequency,
    }


def _elastic_drives(reach, joint):
    springs = [_resonant_drive(reach, joint, hertz, 0.1) for hertz in (4.0, 6.0, 9.0, 13.0, 20.0)]
    return [z | {"link": link, "control": control} for z in springs for link, control in ENCODERS]


def _backlash_drives(reach, joint):
    spring, span = (
        _resonant_drive(reach, joint, 40.0, 0.3),
        float(reach.q_high[joint] - reach.q_low[joint]),
    )
    gaps = [spring | {"gap": share * span} for share in (0.01, 0.04)]
    return [z | {"link": link, "control": control} for z in gaps for link, control in ENCODERS]


DRIVE_COMPLIANCE = Effect(
    "drive_compliance",
    "measurement",
    (Quantity("compliance", "rad/(N m)", 0.0, 0.5, sign=1),),
    drive_compliance,
    "a drive that winds up under torque, with the encoder on the motor's side",
    "high and low torque at like angles",
    ("torque_gain", "encoder_scale", "position_gain"),
    carried=True,
    formula="reading = q + compliance torque",
)

DRIVE_PLAY = Effect(
    "drive_play",
    "measurement",
    (
        Quantity("gap", "rad", 0.0, 0.4, sign=1),
        Quantity(
            "width",
            "N m",
            0.001,
            2.0,
            0.05,
            shape=True,
            meaning="torque at which the motor lies against a side",
        ),
    ),
    drive_play,
    "play in a drive, with the encoder on the motor's side",
    "torque that changes sign at any speed",
    ("drive_compliance", "backlash", "coulomb"),
    carried=True,
    grid=_play_widths,
    formula="reading = q + gap / 2 sign(torque)",
)

DRIVE_ELASTICITY = Effect(
    "drive_elasticity",
    "drive",
    (
        Quantity("compliance", "rad/(N m)", 0.0, 3.0, sign=1),
        DASHPOT,
        *SIDES,
    ),
    drive_elasticity,
    "a drive that gives between its rotor and its link, which swing against each other (Spong, "
    "1987)",
    "fast changes of the torque",
    ("drive_compliance", "delay", "actuator_lag", "armature"),
    jump=True,
    grid=_elastic_drives,
    contains=("drive_compliance",),
    formula="torque on the link = (rotor - link + damping (rotor' - link')) / compliance; of "
    "joints with an armature, the rotor's",
)

DRIVE_BACKLASH = Effect(
    "drive_backlash",
    "drive",
    (
        Quantity("gap", "rad", 0.0, 0.4, sign=1),
        Quantity("compliance", "rad/(N m)", 0.0, 3.0, shape=True),
        DASHPOT,
        *SIDES,
    ),
    drive_backlash,
    "play between a drive's rotor and its link, through which the rotor flies",
    "torque that changes sign at any speed",
    ("drive_play", "backlash", "drive_elasticity", "coulomb"),
    jump=True,
    grid=_backlash_drives,
    contains=("drive_play",),
    formula="as drive_elasticity beyond gap / 2 to either side, no torque within",
)

DRIVES: tuple[Effect, ...] = (DRIVE_COMPLIANCE, DRIVE_PLAY, DRIVE_ELASTICITY, DRIVE_BACKLASH)
