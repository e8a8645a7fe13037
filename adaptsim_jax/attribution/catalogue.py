"""The effects that any joint of a machine may have, with what shows them and what they are mistaken
for.

Each is an `Effect` as of the double pendulum's catalogue; what acts on the torque is a force here,
since the torque of a joint may be made by an actuator's own law from a command.
"""

import jax
import jax.numpy as jnp

from adaptsim_jax.attribution.angle_effects import BY_ANGLE
from adaptsim_jax.attribution.drive_effects import DRIVES
from adaptsim_jax.attribution.parameters import DAMPING_STEP, INERTIA, TILT, TILTS, WIDEST
from adaptsim_jax.effects import disturbance, elastic, friction, grids, inertia
from adaptsim_jax.effects.actuator import actuator_lag, delay
from adaptsim_jax.effects.base import Dry, Effect, Parameter, of_the_engine
from adaptsim_jax.effects.registry import of_other_packages
from adaptsim_jax.effects.sensor import backlash, encoder_offset, sensor_lag

LATEST = 0.05  # s


def damping_step(p):
    return p["step"] * p["damping"]


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
    """Bristles that bend before the joint slides (Dahl, 1968; the integrator has their state);
    their own damping, which LuGre's model (Canudas de Wit et al., 1995) adds, is not modelled.
    """
    return Dry(0.0 * m.q, yielding=p["compliance"] + 0.0 * m.q)


def load_friction(p, m):
    return Dry(p["share"] * jnp.abs(m.u))


def spring(p, m):
    return p["preload"] - p["stiffness"] * m.q


def cogging(p, m):
    return p["sine"] * jnp.sin(p["order"] * m.q) + p["cosine"] * jnp.cos(p["order"] * m.q)


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


def _before(z):
    """Of the joint before each, [n, ...]; zero at the first."""
    return jnp.concatenate([jnp.zeros_like(z[:1]), z[:-1]])


def _after(z):
    """Of the joint after each; zero at the last."""
    return jnp.concatenate([z[1:], jnp.zeros_like(z[:1])])


def torque_coupling(p, m):
    return p["onto"] * _before(m.u) + _after(p["back"] * m.u)


def friction_coupling(p, m):
    return -p["damping"] * _before(m.v) - _after(p["damping"] * m.v)


def sensor_delay(p, t, q, v, first):
    """Cubics between rows; before the first row the motion had gone on at its first
    acceleration.
    """
    shape = jnp.broadcast_shapes(jnp.shape(p["delay"]), q.shape, t.shape)

    def lanes(z):
        return jnp.broadcast_to(z, shape).reshape(shape[0], -1)

    q_late, v_late = jax.vmap(_at_times, 1, 1)(lanes(t), lanes(t - p["delay"]), lanes(q), lanes(v))
    return q_late.reshape(shape), v_late.reshape(shape)


def _at_times(t, at, q, v):
    """Angle and speed `[T]` at times `at [T]` between rows at `t [T]`."""
    k = jnp.clip(jnp.searchsorted(t, at, side="right") - 1, 0, len(t) - 2)
    span = jnp.where(t[k + 1] > t[k], t[k + 1] - t[k], 1.0)
    u, since = (at - t[k]) / span, at - t[k]
    rise = (v[k + 1] - v[k]) / span
    bend = (
        q[k + 1] - q[k] - 0.5 * span * (v[k] + v[k + 1])
    )  # what the mean of both speeds leaves of the way
    inside = q[k] + since * (v[k] + 0.5 * rise * since) + bend * u * u * (3.0 - 2.0 * u)
    before = q[0] + since * (v[0] + 0.5 * rise * since)
    return jnp.where(at < t[0], before, inside), v[k] + rise * since


def encoder_scale(p, t, q, v, first):
    return (1.0 + p["scale"]) * q, (1.0 + p["scale"]) * v


def _late(reach, joint):
    return [{"delay": s} for s in (-0.02, -0.01, -0.004, 0.004, 0.01, 0.02, 0.04)]


def _lags(reach, joint):
    return [{"lag": s} for s in (0.004, 0.01, 0.025, 0.06)]


def _cuts(reach, joint):
    """Limits from nearly what is exceeded now and then down to a twelfth of it."""
    peak, torque = float(reach.peak[joint]), float(reach.torque[joint])
    return [{"cut": 1.0 - 0.9 * torque * 0.8**k / peak, "peak": peak} for k in range(12)]


def _stops(reach, joint):
    """Stops as hard as most are, where the motion ends and a little before."""
    low, high = float(reach.q_low[joint]), float(reach.q_high[joint])
    hard = [
        (0.01 * s * (high - low), k * float(reach.torque[joint]))
        for s in range(4)
        for k in (10.0, 30.0)
    ]
    upper = [{"angle": high - d, "side": 1.0, "stiffness": k} for d, k in hard]
    return upper + [{"angle": low + d, "side": -1.0, "stiffness": k} for d, k in hard]


def _bristles(reach, joint):
    """Compliances with which friction of a tenth of the torque breaks away after these shares of
    the range of motion.
    """
    span = float(reach.q_high[joint] - reach.q_low[joint])
    return [
        {"compliance": s * span / (0.1 * float(reach.torque[joint]))}
        for s in (0.001, 0.003, 0.01, 0.03, 0.1)
    ]


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

OWN: tuple[Effect, ...] = (
    Effect(
        "viscous",
        "force",
        (Parameter("damping", "N m s/rad", 0.0, 10.0, 0.0, sign=1),),
        viscous,
        "friction in proportion to the speed",
        "fast motion",
        ("quadratic_drag", "coulomb"),
        formula="-damping v",
    ),
    Effect(
        "coulomb",
        "force",
        (Parameter("level", "N m", 0.0, 2.0, 0.0, sign=1),),
        coulomb,
        "dry friction: a constant torque against the motion",
        "reversals, and both slow and fast motion",
        ("stribeck", "load_friction", "asymmetric_coulomb"),
        formula="-level sign(v); holds the joint where less than the level would move it",
    ),
    Effect(
        "asymmetric_coulomb",
        "force",
        (Parameter("difference", "N m", -1.0, 1.0, 0.0),),
        asymmetric,
        "dry friction of another level in each direction",
        "both directions at like speeds",
        ("coulomb", "bias"),
        formula="-difference: half of what friction upwards is more than downwards",
    ),
    Effect(
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
    ),
    Effect(
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
    ),
    Effect(
        "load_friction",
        "force",
        (Parameter("share", "1", 0.0, 3.0, 0.0, sign=1),),
        load_friction,
        "dry friction that grows with the torque that the joint carries",
        "high and low torque at like speeds",
        ("coulomb", "stribeck", "torque_gain"),
        formula="-share |torque| sign(v), beside what is there without load",
    ),
    Effect(
        "quadratic_drag",
        "force",
        (Parameter("drag", "N m s^2/rad^2", 0.0, 2.0, 0.0, sign=1),),
        friction.quadratic_drag,
        "air drag or turbulent oil: torque with the square of speed",
        "a wide range of speeds",
        ("viscous", "coulomb"),
        formula="-drag v |v|",
    ),
    Effect(
        "spring",
        "force",
        (
            Parameter("stiffness", "N m/rad", -5.0, 5.0, 0.0, sign=1),
            Parameter("preload", "N m", -5.0, 5.0, 0.0),
        ),
        spring,
        "a torsional spring or a cable; at rest at preload / stiffness",
        "a wide range of angles",
        ("bias", "position_gain", "encoder_offset"),
        formula="preload - stiffness q",
    ),
    Effect(
        "bias",
        "force",
        (Parameter("torque", "N m", -1.0, 1.0, 0.0),),
        disturbance.bias,
        "a constant torque: the torque sensor's zero, a cable's pull",
        "a wide range of angles",
        ("encoder_offset", "tilt", "spring", "asymmetric_coulomb"),
        formula="torque",
    ),
    Effect(
        "cogging",
        "force",
        (
            Parameter("sine", "N m", -1.0, 1.0, 0.0),
            Parameter("cosine", "N m", -1.0, 1.0, 0.0),
            Parameter("order", "1", 2.0, 200.0, 7.0, None, meaning="periods a turn"),
        ),
        cogging,
        "torque ripple periodic in the joint's angle (magnets, gear teeth)",
        "slow sweeps over many periods",
        ("spring",),
        grid=grids.orders,
        formula="sine sin(order q) + cosine cos(order q)",
    ),
    Effect(
        "periodic_disturbance",
        "force",
        (
            Parameter("sine", "N m", -1.0, 1.0, 0.0),
            Parameter("cosine", "N m", -1.0, 1.0, 0.0),
            Parameter("frequency", "Hz", 0.05, 60.0, 2.0, None),
        ),
        disturbance.periodic_disturbance,
        "a torque periodic in time that starts with each trial: a fan, a neighbouring machine",
        "long trials whose commands leave that frequency free",
        ("cogging",),
        grid=grids.frequencies,
        formula="sine sin(2 pi frequency t) + cosine cos(2 pi frequency t), t since the trial began",
    ),
    Effect(
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
    ),
    Effect(
        "hard_stop",
        "force",
        (
            Parameter("stiffness", "N m/rad", 0.0, 300.0, 0.0, sign=1),
            Parameter("angle", "rad", -100.0, 100.0, 1.5, None),
            Parameter("side", "1", -1.0, 1.0, 1.0, None, held=True),
            Parameter("loss", "s", 0.0, 1.0, 0.0, None, optional=True),
            Parameter("damping", "s", 0.0, 0.5, 0.0, None, held=True, optional=True),
            Parameter("exponent", "1", 0.7, 2.5, 1.0, None, held=True, optional=True),
        ),
        elastic.hard_stop,
        "an end stop beyond an angle",
        "motion into the stop, and well inside it",
        ("spring",),
        grid=grids.stops,
        starts=_stops,
        formula="-side stiffness max(0, side (q - angle)) (1 + loss depth')",
    ),
    Effect(
        "armature",
        "force",
        (Parameter("inertia", "kg m^2", 0.0, 1.0, 0.0, sign=1),),
        inertia.rotor_inertia,
        "the rotor's inertia times the gear ratio squared, felt at its own joint",
        "fast motion",
        ("torque_gain", "inertia"),
        inertia=True,
        formula="-inertia dv/dt",
    ),
    Effect(
        DAMPING_STEP,
        "force",
        (
            Parameter("step", "s", -1.0, 1.0, 0.0),
            Parameter("damping", "N m s/rad", 0.0, 1e9, 0.0, None, held=True),
        ),
        damping_step,
        "a simulator's step, or a controller's: the declared damping acts by the speed at another "
        "time in it",
        "fast changes of speed",
        ("armature", "delay"),
        inertia=True,
        formula="-step damping dv/dt",
    ),
    Effect(
        "torque_gain",
        "force",
        (Parameter("gain", "1", -0.9, 2.0, 0.0),),
        torque_gain,
        "the actuator's torque is off by a share",
        "driven motion beside free swings",
        ("torque_gain", "position_gain", "load_friction", "inertia"),
        formula="(1 + gain) torque",
    ),
    Effect(
        "torque_coupling",
        "force",
        (
            Parameter(
                "onto",
                "1",
                -1.0,
                1.0,
                0.0,
                meaning="share of the torque of the joint before that acts here",
            ),
            Parameter(
                "back",
                "1",
                -1.0,
                1.0,
                0.0,
                meaning="share of this joint's torque that acts on the joint before",
            ),
        ),
        torque_coupling,
        "the drives of a joint and of the one before it act on both (a belt, a differential, a "
        "motor at the base)",
        "torques at both joints that differ",
        ("torque_gain", "friction_coupling"),
        pair=True,
        formula="onto torque(before); on the joint before: back torque",
    ),
    Effect(
        "friction_coupling",
        "force",
        (Parameter("damping", "N m s/rad", -10.0, 10.0, 0.0),),
        friction_coupling,
        "viscous friction in a drive that two joints share: of the sum or the difference of their "
        "speeds",
        "fast motion of both joints, apart and together",
        ("torque_coupling", "viscous"),
        pair=True,
        formula="-damping v(before); on the joint before: -damping v",
    ),
    Effect(
        "position_gain",
        "force",
        (Parameter("gain", "1", -0.9, 2.0, 0.0),),
        position_gain,
        "the stiffness of the position controller is off by a share",
        "large position errors",
        ("torque_gain", "spring"),
        formula="(1 + gain) kp (target - q)",
    ),
    Effect(
        "saturation",
        "force",
        (
            Parameter(
                "cut", "1", 0.0, 0.99, 0.0, sign=1, meaning="share cut off the largest torque"
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
    ),
    Effect(
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
    ),
    Effect(
        "delay",
        "command",
        (Parameter("delay", "s", -LATEST, LATEST, 0.0), BEFORE),
        delay,
        "the command reaches the joint late; below zero, its log is late",
        "fast changes of the command",
        ("actuator_lag", "sensor_delay", "sensor_lag"),
        jump=True,
        grid=_late,
        formula="command(t - delay)",
    ),
    Effect(
        "actuator_lag",
        "command",
        (Parameter("lag", "s", 0.0, 0.2, 0.0, sign=1), BEFORE),
        actuator_lag,
        "the joint follows its command as a first-order lag",
        "fast changes of the command",
        ("delay", "sensor_lag", "sensor_delay"),
        jump=True,
        grid=_lags,
        formula="lag torque' = command - torque",
    ),
    Effect(
        "encoder_offset",
        "measurement",
        (Parameter("offset", "rad", -0.8, 0.8, 0.0),),
        encoder_offset,
        "the encoder's zero is not the model's",
        "wide angles under gravity",
        ("bias", "tilt"),
        formula="reading = q + offset",
    ),
    Effect(
        "encoder_scale",
        "measurement",
        (Parameter("scale", "1", -0.5, 0.5, 0.0),),
        encoder_scale,
        "the reading is off by a share (a wrong gear ratio)",
        "wide angles under gravity",
        ("torque_gain",),
        formula="reading = (1 + scale) q",
    ),
    Effect(
        "sensor_delay",
        "measurement",
        (Parameter("delay", "s", 0.0, LATEST, 0.0, sign=1),),
        sensor_delay,
        "the angles are logged late",
        "fast motion",
        ("delay", "sensor_lag"),
        formula="reading(t) = q(t - delay)",
    ),
    Effect(
        "sensor_lag",
        "measurement",
        (Parameter("lag", "s", 0.0, 0.1, 0.0, sign=1),),
        sensor_lag,
        "angle and speed come through a first-order filter",
        "fast motion",
        ("sensor_delay", "delay"),
        jump=True,
        grid=_lags,
        formula="lag reading' = q - reading",
    ),
    *BY_ANGLE,
    *DRIVES,
    Effect(
        "backlash",
        "measurement",
        (Parameter("gap", "rad", 0.0, 0.4, 0.0, sign=1),),
        backlash,
        "play between the link and what its encoder turns with",
        "many reversals",
        ("coulomb",),
        jump=True,
        slack="gap",
        grid=lambda reach, joint: [
            {"gap": g * float(reach.q_high[joint] - reach.q_low[joint])} for g in (0.01, 0.04, 0.15)
        ],
        formula="reading follows q at a distance of at most gap / 2",
    ),
    Effect(
        TILT,
        "model",
        tuple(Parameter(name, "rad", -0.5, 0.5, 0.0) for name in TILTS),
        of_the_engine,
        "gravity pulls along another direction: the base is not level",
        "wide angles under gravity",
        scope="base",
        formula="gravity turned about the world's x and y",
    ),
    Effect(
        INERTIA,
        "model",
        tuple(Parameter(name, "1", -wide, wide, 0.0) for name, wide in WIDEST.items()),
        of_the_engine,
        "a body of another mass, centre of mass or moments than declared: a payload, another part",
        "fast motion, and wide angles under gravity",
        formula="the body's pseudo-inertia U U' becomes U V V' U'",
    ),
)

MACHINE: tuple[Effect, ...] = (*OWN, *of_other_packages(taken=[e.name for e in OWN]))
COMMON = ("delay", "actuator_lag", "sensor_delay", "sensor_lag", "torque_gain")
"""Effects that are tried with one value for all joints as well: those of the one computer that
talks to them.
"""
EVERYWHERE = ("coulomb", "armature", "stribeck", "load_friction", "quadratic_drag")
"""Effects that are tried at all joints at once, with own values: those of like drives."""
