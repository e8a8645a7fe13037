"""Springs, stops, rotors, ripples and couplings at a joint of any machine.

Torque and dry friction that depend on the joint's angle in whatever way are linear between nodes
over the range of motion. What no law of the catalogue describes (a magnet, a cable, a cam, a worn
spot) would otherwise be given the name of the law that is least unlike it. They are tried once no
law holds out any more. A law with fewer parameters has the name wherever it does as well.
"""

import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core.trig import sin_cos
from adaptsim_jax.effects.base import Dry, Effect, Quantity, Traits

NODES = 10  # of a range of motion: a spot of a tenth of it shows
FINEST = 1.0 / 12.0  # Hz between frequencies of the grid: a trial of 6 s tells no more


def bias(p, m):
    return p["torque"] + 0.0 * m.q


def spring(p, m):
    return p["preload"] - p["stiffness"] * m.q


def hard_stop(p, m):
    """A spring beyond an angle that never pulls: an upper stop where `side` is 1, a lower one where
    it is -1.

    It loses energy in proportion to the depth (`loss`; Hunt and Crossley, 1975).
    """
    depth = jnp.maximum(p["side"] * (m.q - p["angle"]), 0.0)
    damped_depth = depth * (1.0 + p["loss"] * p["side"] * m.v)
    return -p["side"] * p["stiffness"] * jnp.maximum(damped_depth, 0.0)


def rotor_inertia(p):
    return p["inertia"]


def periodic_disturbance(p, m):
    sin, cos = sin_cos(2.0 * jnp.pi * p["frequency"] * m.t)
    return p["sine"] * sin + p["cosine"] * cos + 0.0 * m.q


def _order_grid(reach, joint):
    """Of which the motion has seen a period twice: with less it is any slow law of the angle, such
    as gravity's of a body that is not as in the file.
    """
    span = max(float(reach.q_high[joint] - reach.q_low[joint]), 1e-3)
    return [{"order": float(k)} for k in range(max(2, int(np.ceil(4.0 * np.pi / span))), 31)]


def _frequency_grid(reach, joint):
    """Half a cycle of a trial apart, so that no frequency between two points goes unseen; at most
    half of Nyquist. In long trials no finer than `FINEST`.
    """
    top = min(15.0, 0.25 / reach.dt)
    step = max(0.5 / reach.duration, FINEST)
    return [{"frequency": float(f)} for f in np.arange(step, top, step)[:160]]


def _stop_grid(reach, joint):
    low, high = float(reach.q_low[joint]), float(reach.q_high[joint])
    span = high - low
    upper = [{"angle": high - span * s, "side": 1.0} for s in (0.03, 0.08, 0.15, 0.25, 0.4)]
    return upper + [{"angle": low + span * s, "side": -1.0} for s in (0.03, 0.08, 0.15, 0.25, 0.4)]


def cogging(p, m):
    sine = p["sine"] * jnp.sin(p["order"] * m.q)
    return sine + p["cosine"] * jnp.cos(p["order"] * m.q)


def _of_joint_before(z):
    """Return the value of the joint before each, [n, ...]; zero at the first."""
    return jnp.concatenate([jnp.zeros_like(z[:1]), z[:-1]])


def _of_joint_after(z):
    """Return the value of the joint after each; zero at the last."""
    return jnp.concatenate([z[1:], jnp.zeros_like(z[:1])])


def torque_coupling(p, m):
    return p["onto"] * _of_joint_before(m.u) + _of_joint_after(p["back"] * m.u)


def friction_coupling(p, m):
    return -p["damping"] * _of_joint_before(m.v) - _of_joint_after(p["damping"] * m.v)


def _stop_starts(reach, joint):
    """Stops as hard as most are, where the motion ends and a little before. One that is hit hard
    throws the model so far off that a linear score makes it soft and puts it well inside. From
    there no fit finds the way to it.
    """
    low, high = float(reach.q_low[joint]), float(reach.q_high[joint])
    offsets_and_stiffnesses = [
        (0.01 * s * (high - low), k * float(reach.torque[joint]))
        for s in range(4)
        for k in (10.0, 30.0)
    ]
    upper = [{"angle": high - d, "side": 1.0, "stiffness": k} for d, k in offsets_and_stiffnesses]
    return upper + [
        {"angle": low + d, "side": -1.0, "stiffness": k} for d, k in offsets_and_stiffnesses
    ]


def _between(p, q):
    """Value [n, ...] at angles q of what is linear between the nodes, and constant beyond them."""
    x = (NODES - 1) * jnp.clip((q - p["low"]) / (p["high"] - p["low"]), 0.0, 1.0)
    parts = [p[f"at{k}"] * jnp.maximum(0.0, 1.0 - jnp.abs(x - k)) for k in range(NODES)]
    return sum(parts, start=jnp.zeros(()))


def angle_torque(p, m):
    return _between(p, m.q)


def angle_friction(p, m):
    return Dry(_between(p, m.q))


def _parameters() -> tuple[Quantity, ...]:
    """A weak prior, so that a level which is the same everywhere is Coulomb's, and a node that no
    motion passes has none.
    """
    nodes = [
        Quantity(f"at{k}", "N m", -1.0, 1.0, meaning=f"at node {k}", prior=0.3)
        for k in range(NODES)
    ]
    ends = [
        Quantity(
            name,
            "rad",
            -1e9,
            1e9,
            at,
            shape=True,
            held=True,
            meaning=f"angle of the {which} node; not fitted",
        )
        for name, at, which in (("low", -1.0, "first"), ("high", 1.0, "last"))
    ]
    return (*nodes, *ends)


def _motion_range(reach, joint):
    return [{"low": float(reach.q_low[joint]), "high": float(reach.q_high[joint])}]


SPRING = Effect(
    "spring",
    "force",
    (
        Quantity("stiffness", "N m/rad", -5.0, 5.0, sign=1, mjcf="stiffness"),
        Quantity("preload", "N m", -5.0, 5.0, mjcf="preload"),
    ),
    spring,
    "a torsional spring or a cable; at rest at preload / stiffness",
    "a wide range of angles",
    ("bias", "position_gain", "encoder_offset"),
    formula="preload - stiffness q",
    title="torsional spring",
)

BIAS = Effect(
    "bias",
    "force",
    (Quantity("torque", "N m", -1.0, 1.0, mjcf="torque"),),
    bias,
    "a constant torque: the torque sensor's zero, a cable's pull",
    "a wide range of angles",
    ("encoder_offset", "tilt", "spring", "asymmetric_coulomb"),
    formula="torque",
)

COGGING = Effect(
    "cogging",
    "force",
    (
        Quantity("sine", "N m", -1.0, 1.0),
        Quantity("cosine", "N m", -1.0, 1.0),
        Quantity("order", "1", 2.0, 200.0, 7.0, shape=True, meaning="periods a turn"),
    ),
    cogging,
    "torque ripple periodic in the joint's angle (magnets, gear teeth)",
    "slow sweeps over many periods",
    ("spring",),
    grid=_order_grid,
    formula="sine sin(order q) + cosine cos(order q)",
)

PERIODIC_DISTURBANCE = Effect(
    "periodic_disturbance",
    "force",
    (
        Quantity("sine", "N m", -1.0, 1.0),
        Quantity("cosine", "N m", -1.0, 1.0),
        Quantity("frequency", "Hz", 0.05, 60.0, 2.0, shape=True),
    ),
    periodic_disturbance,
    "a torque periodic in time that starts with each trial: a fan, a neighbouring machine",
    "long trials whose commands leave that frequency free",
    ("cogging",),
    grid=_frequency_grid,
    formula="sine sin(2 pi frequency t) + cosine cos(2 pi frequency t), t since the trial began",
    traits=Traits(in_balance=False),
)

HARD_STOP = Effect(
    "hard_stop",
    "force",
    (
        Quantity("stiffness", "N m/rad", 0.0, 300.0, sign=1, mjcf="stop"),
        Quantity("angle", "rad", -100.0, 100.0, 1.5, shape=True),
        Quantity("side", "1", -1.0, 1.0, 1.0, shape=True, held=True),
        Quantity("loss", "s", 0.0, 1.0, shape=True, optional=True),
    ),
    hard_stop,
    "an end stop beyond an angle",
    "motion into the stop, and well inside it",
    ("spring",),
    grid=_stop_grid,
    starts=_stop_starts,
    formula="-side stiffness max(0, side (q - angle)) (1 + loss depth')",
    traits=Traits(in_balance=False),
)

ARMATURE = Effect(
    "armature",
    "force",
    (Quantity("inertia", "kg m^2", 0.0, 1.0, sign=1, mjcf="armature"),),
    rotor_inertia,
    "the rotor's inertia times the gear ratio squared, felt at its own joint",
    "fast motion",
    ("torque_gain", "inertia"),
    inertia=True,
    formula="-inertia dv/dt",
    traits=Traits(family=True, tried_first=3),
)

TORQUE_COUPLING = Effect(
    "torque_coupling",
    "force",
    (
        Quantity(
            "onto",
            "1",
            -1.0,
            1.0,
            meaning="share of the torque of the joint before that acts here",
        ),
        Quantity(
            "back",
            "1",
            -1.0,
            1.0,
            meaning="share of this joint's torque that acts on the joint before",
        ),
    ),
    torque_coupling,
    "the drives of a joint and of the one before it act on both (a belt, a differential, a motor "
    "at the base)",
    "torques at both joints that differ",
    ("torque_gain", "friction_coupling"),
    pair=True,
    formula="onto torque(before); on the joint before: back torque",
)

FRICTION_COUPLING = Effect(
    "friction_coupling",
    "force",
    (Quantity("damping", "N m s/rad", -10.0, 10.0),),
    friction_coupling,
    "viscous friction in a drive that two joints share: of the sum or the difference of their "
    "speeds",
    "fast motion of both joints, apart and together",
    ("torque_coupling", "viscous"),
    pair=True,
    formula="-damping v(before); on the joint before: -damping v",
)

BY_ANGLE: tuple[Effect, ...] = (
    Effect(
        "angle_torque",
        "force",
        _parameters(),
        angle_torque,
        "a torque that depends on the angle in a way of its own (a magnet, a cable, a cam)",
        "slow and fast passes over the whole range",
        ("cogging", "spring", "bias", "hard_stop"),
        grid=_motion_range,
        describes=True,
        formula=f"linear in q between {NODES} nodes from low to high, constant beyond",
    ),
    Effect(
        "angle_friction",
        "force",
        _parameters(),
        angle_friction,
        "dry friction whose level depends on the angle (a worn spot, a bent shaft)",
        "reversals all over the range",
        ("coulomb", "stribeck", "load_friction", "asymmetric_coulomb"),
        grid=_motion_range,
        describes=True,
        formula="-level(q) sign(v), level linear between nodes, beside what is there anywhere",
    ),
)
