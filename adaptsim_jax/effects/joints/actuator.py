"""Between what a joint of any machine was told and the torque that its actuator gives."""

import jax.numpy as jnp

from adaptsim_jax.effects.actuator import actuator_lag, delay
from adaptsim_jax.effects.base import Effect, Parameter, Traits

LATEST = 0.05  # s


def torque_gain(p, m):
    return p["gain"] * m.u


def position_gain(p, m):
    return p["gain"] * m.pull


def saturation(p, m):
    """The limit is a share cut off the largest force, so that no cut changes nothing."""
    limit = (1.0 - p["cut"]) * p["peak"]
    return jnp.clip(m.u, -limit, limit) - m.u


def dead_zone(p, m):
    return -jnp.clip(m.u, -p["width"], p["width"])


def _late(reach, joint):
    return [{"delay": s} for s in (-0.02, -0.01, -0.004, 0.004, 0.01, 0.02, 0.04)]


def lags(reach, joint):
    return [{"lag": s} for s in (0.004, 0.01, 0.025, 0.06)]


def _cuts(reach, joint):
    """Limits from nearly what is exceeded now and then down to a twelfth of it."""
    peak, torque = float(reach.peak[joint]), float(reach.torque[joint])
    return [{"cut": 1.0 - 0.9 * torque * 0.8**k / peak, "peak": peak} for k in range(12)]


def _widths(reach, joint):
    return [{"width": float(reach.torque[joint]) * s} for s in (0.01, 0.03, 0.08)]


BEFORE = Parameter(
    "before",
    "1",
    0.0,
    1.0,
    1.0,
    None,
    held=True,
    optional=True,
    meaning="share of its first command ahead of the log",
)

TORQUE_GAIN = Effect(
    "torque_gain",
    "force",
    (Parameter("gain", "1", -0.9, 2.0, 0.0, factor=True, mjcf="gain"),),
    torque_gain,
    "the actuator's torque is off by a share",
    "driven motion beside free swings",
    ("torque_gain", "position_gain", "load_friction", "inertia"),
    formula="(1 + gain) torque",
    traits=Traits(on_actuator=True, scales_drive=True, shared=True, prior=0.3),
)

POSITION_GAIN = Effect(
    "position_gain",
    "force",
    (Parameter("gain", "1", -0.9, 2.0, 0.0, factor=True, mjcf="kp"),),
    position_gain,
    "the stiffness of the position controller is off by a share",
    "large position errors",
    ("torque_gain", "spring"),
    formula="(1 + gain) kp (target - q)",
    traits=Traits(on_actuator=True, scales_drive=True, of_controller=True),
)

SATURATION = Effect(
    "saturation",
    "force",
    (
        Parameter(
            "cut",
            "1",
            0.0,
            0.99,
            0.0,
            sign=1,
            meaning="share cut off the largest torque",
            mjcf="limit",
        ),
        Parameter(
            "peak",
            "N m",
            0.0,
            1e9,
            1e9,
            None,
            held=True,
            meaning="the largest torque; not fitted",
        ),
    ),
    saturation,
    "the torque cannot exceed a limit",
    "torques near and below the limit",
    ("torque_gain",),
    jump=True,
    grid=_cuts,
    starts=_cuts,
    formula="torque within +-(1 - cut) peak",
    traits=Traits(on_actuator=True),
)

DEAD_ZONE = Effect(
    "dead_zone",
    "force",
    (Parameter("width", "N m", 0.0, 0.9, 0.0, sign=1),),
    dead_zone,
    "torques below a width move nothing, larger ones lose it",
    "small and large torques",
    ("coulomb", "torque_gain"),
    jump=True,
    grid=_widths,
    formula="torque less width, zero within +-width",
    traits=Traits(on_actuator=True),
)

DELAY = Effect(
    "delay",
    "command",
    (Parameter("delay", "s", -LATEST, LATEST, 0.0, mjcf="delay"), BEFORE),
    delay,
    "the command reaches the joint late; below zero, its log is late",
    "fast changes of the command",
    ("actuator_lag", "sensor_delay", "sensor_lag"),
    jump=True,
    grid=_late,
    formula="command(t - delay)",
    traits=Traits(shared=True, tried_first=1),
    title="command delay",
)

ACTUATOR_LAG = Effect(
    "actuator_lag",
    "command",
    (Parameter("lag", "s", 0.0, 0.2, 0.0, sign=1, mjcf="lag"), BEFORE),
    actuator_lag,
    "the joint follows its command as a first-order lag",
    "fast changes of the command",
    ("delay", "sensor_lag", "sensor_delay"),
    jump=True,
    grid=lags,
    formula="lag torque' = command - torque",
    traits=Traits(shared=True),
)
