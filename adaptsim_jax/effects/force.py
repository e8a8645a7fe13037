"""Effects that act as a generalized force at a joint."""

import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core.trig import sin_cos
from adaptsim_jax.effects import grids as effects_grids
from adaptsim_jax.effects.base import Dry, Effect, Motion, Parameter, Relaxation

LEAST_PERIODS = 0.6  # of a torque's period that the angles must cover, and half of what a trial must
HERTZ_DEPTH = 0.1  # rad
MOST_LEANING = 0.5  # of the time on a stop: beyond that it is a spring
LEAST_FADING = 0.2  # of friction within a trial, for it to be a drift
WIDTH = Parameter(
    "width", "rad/s", 0.0, 0.2, 0.0, None, optional=True, meaning="within which it turns; 0 is sharp", late=True
)
LEAST_EXCESS = 0.1  # of the level at speed, by which Stribeck's friction is higher at rest


def coulomb(p, m: Motion):
    return Dry(p["level"] + 0.0 * m.q, width=p["width"])


def stribeck(p, m: Motion):
    """Bo and Pavelescu's (1982) Gaussian fall from break-away to sliding friction."""
    return Dry(p["level"] + p["excess"] * jnp.exp(-jnp.square(m.v / p["speed"])), width=p["width"])


def quadratic_drag(p, m: Motion):
    return -p["drag"] * m.v * jnp.abs(m.v)


def spring(p, m: Motion):
    """A cubic about any angle, written about zero: a spring that hardens need not do so about the joint's zero."""
    return p["preload"] - p["stiffness"] * m.q * (1.0 + p["bend"] * m.q + p["hardening"] * m.q**2)


def bias(p, m: Motion):
    return p["torque"] + 0.0 * m.q


def cogging(p, m: Motion):
    """A ripple and its second harmonic, which is written as a share of the first and turned with it."""
    at = p["order"] * m.q
    sine, cosine, ahead, across = p["sine"], p["cosine"], p["second_sine"], p["second_cosine"]
    sin, cos = sin_cos(at)
    second_sine, second_cosine = sine * ahead - cosine * across, sine * across + cosine * ahead
    return sine * sin + cosine * cos + second_sine * 2.0 * sin * cos + second_cosine * (cos * cos - sin * sin)


def friction_drift(p, m: Motion):
    """Friction that is there when the trial begins and fades as the joint warms."""
    fade = jnp.exp(-m.t / p["decay"])
    return Dry(p["dry"] * fade + 0.0 * m.q, -p["viscous"] * fade * m.v)


def at_phase(p, m: Motion):
    """What goes on between trials, so that each trial meets it at another phase."""
    phase = 2.0 * jnp.pi * p["frequency"] * (m.t if m.clock is None else m.clock)
    sin, cos = sin_cos(phase)
    return p["sine"] * sin + p["cosine"] * cos


def periodic_disturbance(p, m: Motion):
    return at_phase(p, m) + 0.0 * m.q


def hard_stop(p, m: Motion):
    """A spring beyond an angle that never pulls: an upper stop where `side` is 1, a lower one where it is -1.

    It loses energy as a dashpot beside the spring (`damping`, Kelvin and Voigt), or in proportion to the depth (`loss`;
    Hunt and Crossley, 1975). A round contact is softer where it touches: `exponent` 1.5 is Hertz's, and the stiffness is then
    force over depth at `HERTZ_DEPTH`.
    """
    depth = jnp.maximum(p["side"] * (m.q - p["angle"]), 0.0)
    inward = p["side"] * m.v
    spring_like = depth * jnp.power(jnp.maximum(depth, 1e-6) / HERTZ_DEPTH, p["exponent"] - 1.0)
    pressed = spring_like * (1.0 + p["loss"] * inward) + jnp.where(depth > 0.0, p["damping"] * inward, 0.0)
    return -p["side"] * p["stiffness"] * jnp.maximum(pressed, 0.0)


def load_friction(p, m: Motion):
    return Dry(p["share"] * jnp.abs(m.u), width=p["width"])


def presliding(p, m: Motion):
    """Dahl (1968): a bristle bends before the joint slides; memory is its deflection over the break-away deflection.
    With damping it is LuGre (Canudas de Wit et al., 1995): the bristle's rate resists too."""
    speed = jnp.abs(m.v)
    rate = (m.v - speed * m.memory) / p["deflection"]
    force = -p["level"] * (m.memory + p["damping"] * rate)
    return Relaxation(force, m.v / jnp.sqrt(speed**2 + 1e-12), speed / p["deflection"])


def rotor_inertia(p):
    return p["inertia"]


def _no_ripple(value, error, q, duration) -> str:
    """A part of a period is any smooth function of the angle; once a turn is gravity's own."""
    low, high = np.quantile(q, [0.005, 0.995]) if len(q) else (0.0, 0.0)
    periods = value["order"] * (high - low) / (2.0 * np.pi)
    return f"the motion covers {periods:.1f} of its periods, as of any smooth torque" if periods < LEAST_PERIODS else ""


def no_period(value, error, q, duration) -> str:
    """A part of a period is a drift."""
    periods = value["frequency"] * duration
    return f"a trial holds {periods:.1f} of its periods, as of any drift" if periods < 2.0 * LEAST_PERIODS else ""


def _no_spring(value, error, q, duration) -> str:
    """Without a stiffness it is a constant torque."""
    slack = value["stiffness"] < 3.0 * error.get("stiffness", 0.0)
    return "its stiffness is no different from zero, which makes it a constant torque" if slack else ""


def _no_drift(value, error, q, duration) -> str:
    """What hardly fades while a trial lasts is dry and viscous friction, whose viscous part the declared damping may take back."""
    fades = 1.0 - np.exp(-duration / value["decay"])
    return f"it fades by {100 * fades:.0f} % in a trial, as friction that stays" if fades < LEAST_FADING else ""


def _no_stribeck(value, error, q, duration) -> str:
    """With hardly any excess it is dry friction, and the excess takes up what another effect has left."""
    more = value["excess"] / max(value["level"], 1e-12)
    return f"it is {100 * more:.0f} % higher at rest, as plain dry friction" if more < LEAST_EXCESS else ""


def _no_stop(value, error, q, duration) -> str:
    """Where the joint leans on it nearly always it is a spring, with a constant torque in the other effect's place."""
    leaning = float(np.mean(value["side"] * (q - value["angle"]) > 0.0)) if len(q) else 0.0
    return (
        f"the joint would lean on it {100 * leaning:.0f} % of the time, as on a spring"
        if leaning > MOST_LEANING
        else ""
    )


FORCE = (
    Effect(
        "coulomb", "force", (Parameter("level", "N m", 0.0, 1.0, 0.0, sign=1, plausible=0.5), WIDTH), coulomb,
        "dry friction: a constant torque against the motion", "reversals, and both slow and fast motion",
        ("stribeck", "presliding", "load_friction", "dead_zone", "friction_drift"),
        formula="-level sign(v), or tanh(v / width); holds the joint where less than the level would move it",
    ),
    Effect(
        "stribeck", "force",
        (
            Parameter("level", "N m", 0.0, 1.0, 0.0, sign=1, plausible=0.5),
            Parameter("excess", "N m", 0.0, 2.0, 0.0, sign=1, plausible=1.0, meaning="how much more at rest"),
            Parameter("speed", "rad/s", 0.02, 20.0, 0.5, None, meaning="at which the excess has fallen to a third"),
            WIDTH,
        ),
        stribeck, "dry friction that is higher at creeping speed", "long stretches of slow motion beside fast ones",
        ("coulomb", "presliding"), contains=("coulomb",), grid=effects_grids.speeds, amiss=_no_stribeck,
        formula="-(level + excess exp(-(v / speed)^2)) sign(v), or tanh(v / width)",
    ),
    Effect(
        "quadratic_drag", "force", (Parameter("drag", "N m s^2/rad^2", 0.0, 1.0, 0.0, sign=1, plausible=0.1),),
        quadratic_drag, "air drag or turbulent oil: torque with the square of speed", "a wide range of speeds",
        ("coulomb", "friction_drift"),
        formula="-drag v |v|",
    ),
    Effect(
        "spring", "force",
        (
            Parameter("stiffness", "N m/rad", -5.0, 5.0, 0.0, sign=1, plausible=2.0),
            Parameter("preload", "N m", -5.0, 5.0, 0.0),
            Parameter("bend", "1/rad", -5.0, 5.0, 0.0, None, optional=True, meaning="lopsidedness", late=True),
            Parameter("hardening", "1/rad^2", -5.0, 5.0, 0.0, None, optional=True, meaning="cubic share", late=True),
        ),
        spring, "a torsional spring, or a cable that pulls back; at rest at preload / stiffness",
        "a wide range of angles",
        ("bias", "tilt", "encoder_offset", "hard_stop"), contains=("bias",), amiss=_no_spring,
        formula="preload - stiffness q (1 + bend q + hardening q^2)",
    ),
    Effect(
        "bias", "force", (Parameter("torque", "N m", -1.0, 1.0, 0.0, plausible=0.5),), bias,
        "a constant torque: torque-sensor zero, cable pull, imbalance", "a wide range of angles",
        ("tilt", "encoder_offset", "spring"),
        formula="torque",
    ),
    Effect(
        "cogging", "force",
        (
            Parameter("sine", "N m", -1.0, 1.0, 0.0, plausible=0.5),
            Parameter("cosine", "N m", -1.0, 1.0, 0.0, plausible=0.5),
            Parameter("order", "1", 2.0, 200.0, 7.0, None, meaning="periods a turn"),
            Parameter("second_sine", "1", -1.0, 1.0, 0.0, None, optional=True, meaning="second harmonic", late=True),
            Parameter("second_cosine", "1", -1.0, 1.0, 0.0, None, optional=True, meaning="second harmonic", late=True),
        ),
        cogging, "torque ripple periodic in the joint's angle (magnets, gear teeth)", "slow sweeps over many periods",
        ("spring",), grid=effects_grids.orders, amiss=_no_ripple,
        formula="sine sin(order q) + cosine cos(order q) + second harmonic",
    ),
    Effect(
        "friction_drift", "force",
        (
            Parameter("viscous", "N m s/rad", -1.0, 1.0, 0.0, plausible=0.5),
            Parameter("dry", "N m", -1.0, 1.0, 0.0, plausible=0.5),
            Parameter("decay", "s", 0.05, 100.0, 2.0, None, meaning="time to fall to a third"),
        ),
        friction_drift, "friction that changes as the joint warms up within a trial",
        "the same motion early and late in a trial", ("coulomb", "quadratic_drag"), grid=effects_grids.decays,
        amiss=_no_drift,
        formula="-(dry sign(v) + viscous v) exp(-t / decay), t since the trial began",
    ),
    Effect(
        "periodic_disturbance", "force",
        (
            Parameter("sine", "N m", -1.0, 1.0, 0.0, plausible=0.5),
            Parameter("cosine", "N m", -1.0, 1.0, 0.0, plausible=0.5),
            Parameter("frequency", "Hz", 0.05, 60.0, 2.0, None),
        ),
        periodic_disturbance, "a torque periodic in time: a fan, mains, a neighbouring machine",
        "long trials whose commands leave that frequency free", ("cogging",), clocked=True, grid=effects_grids.frequencies,
        amiss=no_period,
        formula="sine sin(2 pi frequency t) + cosine cos(2 pi frequency t), t through all trials",
    ),
    Effect(
        "hard_stop", "force",
        (
            Parameter("stiffness", "N m/rad", 0.0, 300.0, 0.0, sign=1),
            Parameter("angle", "rad", -100.0, 100.0, 1.5, None),
            Parameter("side", "1", -1.0, 1.0, 1.0, None, held=True, meaning="1: stops motion upwards, -1: downwards"),
            Parameter("loss", "s", 0.0, 1.0, 0.0, None, optional=True, meaning="energy lost in proportion to depth"),
            Parameter("damping", "s", 0.0, 0.5, 0.0, None, optional=True, meaning="a dashpot beside the spring, over its stiffness"),
            Parameter("exponent", "1", 0.7, 2.5, 1.0, None, optional=True, meaning="of depth; 1.5 is Hertz's", late=True),
        ),
        hard_stop, "an end stop or a taut cable beyond an angle", "motion into the stop, and well inside it",
        ("spring", "cogging"), smooth=False, grid=effects_grids.stops,
        starts=effects_grids.stiff_stops, amiss=_no_stop,
        formula="-side stiffness max(0, depth^exponent (1 + loss depth') + damping depth'), depth = max(0, side (q - angle))",
    ),
    Effect(
        "load_friction", "force", (Parameter("share", "1", 0.0, 1.0, 0.0, sign=1, plausible=0.6), WIDTH), load_friction,
        "gear friction in proportion to the torque that the joint carries", "high and low torque at like speeds",
        ("coulomb", "torque_gain"),
        formula="-share |command| sign(v), or tanh(v / width)",
    ),
    Effect(
        "presliding", "force",
        (
            Parameter("level", "N m", 0.0, 1.0, 0.0, sign=1, plausible=0.5),
            Parameter("deflection", "rad", 1e-3, 0.5, 0.02, None, meaning="at which it breaks away"),
            Parameter("damping", "s", 0.0, 0.1, 0.0, None, meaning="of the bristle; 0 is Dahl, more is LuGre"),
        ),
        presliding, "friction that acts as a spring before the joint slides (Dahl, LuGre)",
        "many small reversals of less than the break-away deflection", ("coulomb", "stribeck", "backlash"),
        memory=True, smooth=False, contains=("coulomb",), grid=effects_grids.deflections,
        formula="-level (z + damping z'), z' = (v - |v| z) / deflection",
    ),
    Effect(
        "rotor_inertia", "force", (Parameter("inertia", "kg m^2", 0.0, 1.0, 0.0, sign=1, plausible=0.3),),
        rotor_inertia,
        "the motor's inertia times gear ratio squared, felt at its own joint only (large ratio: the coupling through "
        "the moving stator is smaller by the ratio and left out); at joint 1 a rigid body's own inertia absorbs it",
        "fast motion of both joints with the elbow straight and bent", ("torque_gain",), inertia=True,
        formula="-inertia dv/dt, of its own joint only",
    ),
)  # fmt: skip
