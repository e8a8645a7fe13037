"""The law of a servo at a joint: its numbers, what the model file says of them, and the coordinates
in which they are fitted.

    force = clip(kp (target - q) + kd (rate - inside v), +-limit) - kd (1 - inside) v - damping v
            + lift g(q) - dry friction

Where the damping is heavy only ratios to kp show, and the scale of all of them is nearly free. So a
fit moves `scale` (kp, damping, friction, limit together), and the others by themselves.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import mujoco
import numpy as np

from adaptsim_jax.logs.log import Log
from adaptsim_jax.simulators.closed_loop.criteria import CLOSED_LOOP
from adaptsim_jax.simulators.mujoco.build import SteppedModel

OPEN = 1e6  # N m (N): a limit that is none
SHARP_REFERENCE = (0.004, 1.0)
SHARP_IMPEDANCE = (0.99, 0.99, 0.001, 0.5, 2.0)
"""Of MuJoCo's dry friction, so that a joint at rest stays there."""


class ServoLaw(NamedTuple):
    """Numbers of a servo; arrays where there are several laws.

    Args:
        kp: N m/rad (N/m).
        damping: Of controller and joint together, N m s/rad.
        rub: Dry friction, N m.
        limit: Of the controller's force, N m.
        delay, lag: Of the target, s.
        rotor: Inertia beyond the file's, kg m^2.
        payload: Mass beyond the file's that the last body carries, kg.
        reach: From that body's centre of mass outward to the payload's, m. Of whole trials alone.
        lift: Share of gravity that the controller feeds forward (1).
        offset: Of the target, rad.
        spring: About the angle zero, N m/rad.
        zero: By which the encoder reads too much, for the log and the controller alike, rad.
        inside: 1: the limit cuts the whole force; 0: its part by the position error alone, as the
            voltage of a motor is before its back electromotive force.
        sharp: 1: dry friction holds a joint still; 0: it creeps, as MuJoCo's does.
        damping_delay: By which damping acts late (early: below 0), s, as steps of a simulator or of
            a controller make it: to first order a lighter joint. Of whole trials alone.
        shift: By which targets act late, s, likewise.
    """

    kp: Any
    damping: Any
    rub: Any
    limit: Any
    delay: Any
    lag: Any
    rotor: Any
    payload: Any
    lift: Any
    offset: Any
    spring: Any
    zero: Any
    inside: Any
    sharp: Any
    damping_delay: Any = 0.0
    shift: Any = 0.0
    reach: Any = 0.0


MAX_LIGHTENING = (
    0.3  # of a joint's bodies, by which a rotor of less than nothing may make it lighter
)

SCALED = ("kp", "damping", "rub", "limit")
"""Numbers that the coordinate `scale` multiplies."""
SHARED = ("delay", "lag", "payload", "lift", "rotor")
"""Numbers that all joints may share."""


@dataclass(frozen=True)
class Servo:
    """A joint that follows targets, as the model file has it.

    Args:
        name: Of the joint.
        joint: Its place in the log.
        actuator: Its actuator's number in the MuJoCo model.
        driver: Its name.
        command: What the log calls its input.
        dof, qpos: Its places in qvel and qpos.
        gear: Of the actuator.
        follows_speed: Whether a target is a speed.
        slides: Whether the joint does.
        law: The file's.
        passive: Damping of the joint alone, N m s/rad.
        armature: kg m^2.
        target: (factor, offset) that make a logged command the target in rad (rad/s).
        command_range: Within which commands act.
        ends: Of the joint's range, rad.
        rest: Of the joint's spring, rad.
        excluded: Numbers of the law that are not fitted.
    """

    name: str
    joint: int
    actuator: int
    driver: str
    command: str
    dof: int
    qpos: int
    gear: float
    follows_speed: bool
    slides: bool
    law: ServoLaw
    passive: float
    armature: float
    target: tuple[float, float]
    command_range: tuple[float, float]
    ends: tuple[float, float]
    rest: float
    excluded: frozenset[str] = frozenset()

    @property
    def free(self) -> tuple[str, ...]:
        """Coordinates of a law that is fitted."""
        if self.follows_speed:
            return self.allowed("scale", "rub")
        return self.allowed("scale", "damping", "rub")

    def allowed(self, *names: str) -> tuple[str, ...]:
        """Return those of some numbers that may be fitted."""
        return tuple(n for n in names if n not in self.excluded)


def servos_of(stepped_model: SteppedModel, log: Log) -> tuple[Servo, ...]:
    """The servos of a machine of which each logged joint has one, or is tied to others; empty for
    any other machine.
    """
    model = stepped_model.model
    if log.input_kind != "command":
        return ()
    lift, inputs, coupled = _compensated_share(model), set(log.input_names), _coupled_joints(model)
    servos = []
    for j, name in enumerate(log.joint_names):
        joint = model.joint(name).id
        actuators = [k for k in range(model.nu) if _drives(model, k, joint)]
        if not actuators and joint in coupled:
            continue
        if len(actuators) != 1 or not _is_servo(model, actuators[0]):
            return ()
        command = next((c for c in (model.actuator(actuators[0]).name, name) if c in inputs), None)
        if command is None:
            return ()
        servos.append(_servo(model, j, (name, command), actuators[0], lift))
    return tuple(servos)


def _coupled_joints(model: mujoco.MjModel) -> set[int]:
    """Joints that an equality or a tendon ties to others."""
    coupled = set()
    for e in np.flatnonzero(model.eq_active0):
        if model.eq_type[e] == int(mujoco.mjtEq.mjEQ_JOINT) and model.eq_obj2id[e] >= 0:
            coupled |= {int(model.eq_obj1id[e]), int(model.eq_obj2id[e])}
    for w in range(model.nwrap):
        if model.wrap_type[w] == int(mujoco.mjtWrap.mjWRAP_JOINT):
            coupled.add(int(model.wrap_objid[w]))
    return coupled


def _drives(model: mujoco.MjModel, actuator: int, joint: int) -> bool:
    at_joint = model.actuator_trntype[actuator] == int(mujoco.mjtTrn.mjTRN_JOINT)
    return bool(at_joint and model.actuator_trnid[actuator, 0] == joint)


def _is_servo(model: mujoco.MjModel, k: int) -> bool:
    """Whether an actuator is a position or velocity servo, with a filter at most."""
    bias = model.actuator_biasprm[k]
    is_affine = model.actuator_biastype[k] == int(mujoco.mjtBias.mjBIAS_AFFINE)
    has_one_gain = model.actuator_gaintype[k] == int(mujoco.mjtGain.mjGAIN_FIXED)
    dynamics = model.actuator_dyntype[k]
    has_filter_at_most = dynamics in (
        int(mujoco.mjtDyn.mjDYN_NONE),
        int(mujoco.mjtDyn.mjDYN_FILTER),
        int(mujoco.mjtDyn.mjDYN_FILTEREXACT),
    )
    return bool(
        is_affine and has_one_gain and has_filter_at_most and (bias[1] < 0.0 or bias[2] < 0.0)
    )


def _compensated_share(model: mujoco.MjModel) -> float:
    """Share of gravity that the file compensates: the median of its bodies with a mass."""
    has_mass = model.body_mass[1:] > 0.0
    if not model.ngravcomp or not has_mass.any():
        return 0.0
    return float(np.median(model.body_gravcomp[1:][has_mass]))


def _servo(model: mujoco.MjModel, j: int, names: tuple[str, str], k: int, lift: float) -> Servo:
    """names: of the joint and of its input in the log."""
    name, command = names
    joint, gear = model.joint(name), float(model.actuator_gear[k, 0])
    dof = int(joint.dofadr[0])
    gain, bias = float(model.actuator_gainprm[k, 0]), model.actuator_biasprm[k]
    kp, kv = -float(bias[1]) * gear**2, -float(bias[2]) * gear**2
    passive = float(model.dof_damping[dof])
    follows_speed = kp <= 0.0
    stiffness = -float(bias[2] if follows_speed else bias[1])
    limit = OPEN
    if model.actuator_forcelimited[k]:
        limit = float(np.abs(model.actuator_forcerange[k]).min()) * abs(gear)
    if model.jnt_actfrclimited[joint.id]:
        limit = min(limit, float(np.abs(model.jnt_actfrcrange[joint.id]).min()))
    lag = float(model.actuator_dynprm[k, 0]) if model.actuator_dyntype[k] else 0.0
    law = ServoLaw(
        kp=max(kp, 0.0),
        damping=kv + passive,
        rub=float(model.dof_frictionloss[dof]),
        limit=limit,
        delay=0.0,
        lag=lag,
        rotor=0.0,
        payload=0.0,
        lift=lift,
        offset=0.0,
        spring=float(model.jnt_stiffness[joint.id]),
        zero=0.0,
        inside=1.0,
        sharp=1.0,
    )
    return Servo(
        name,
        j,
        k,
        model.actuator(k).name,
        command,
        dof,
        int(joint.qposadr[0]),
        gear,
        follows_speed,
        joint.type[0] == int(mujoco.mjtJoint.mjJNT_SLIDE),
        law,
        passive,
        float(model.dof_armature[dof]),
        (gain / (stiffness * gear), float(bias[0]) / (stiffness * gear)),
        _command_range(model, k),
        _ends(model, joint.id),
        float(model.qpos_spring[joint.qposadr[0]]) if model.jnt_stiffness[joint.id] else 0.0,
    )


def _ends(model: mujoco.MjModel, joint: int) -> tuple[float, float]:
    if not model.jnt_limited[joint]:
        return -np.inf, np.inf
    low, high = model.jnt_range[joint]
    return float(low), float(high)


def _command_range(model: mujoco.MjModel, k: int) -> tuple[float, float]:
    if not model.actuator_ctrllimited[k]:
        return -np.inf, np.inf
    low, high = model.actuator_ctrlrange[k]
    return float(low), float(high)


@dataclass(frozen=True)
class Scales:
    """Sizes of a joint's numbers, by which coordinates are without unit.

    Args:
        force: Usual force of the servo, N m.
        inertia: About the joint, kg m^2.
        hand: Mass of the body that carries a payload, kg.
        error: Usual distance of target and angle, rad.
        swing: How far the joint moves, rad.
    """

    force: float
    inertia: float
    hand: float
    error: float
    swing: float

    def unit(self, name: str) -> float:
        """The size of a coordinate of 1."""
        constants = {"delay": 0.01, "lag": 0.01, "lift": 1.0, "offset": 0.01, "zero": 0.05}
        constants |= {"damping_delay": 1e-3, "shift": 1e-3, "reach": 0.05}
        by_joint = {"rub": self.force, "rotor": self.inertia, "payload": max(self.hand, 1e-3)}
        by_joint["spring"] = self.force / max(self.swing, 1e-3)
        return (constants | by_joint)[name]


LOGARITHMIC = ("scale", "damping", "limit")


def step_law(
    servo: Servo, scales: Scales, law: ServoLaw, free: tuple[str, ...], step: np.ndarray
) -> ServoLaw:
    """The law a step [len(free)] away in the coordinates of `free`, within what a servo may have.

    A step of a logarithmic coordinate is at most 2.
    """
    steps = dict(zip(free, np.clip(step, -2.0, 2.0), strict=True))
    factor = float(np.exp(steps.pop("scale", 0.0)))
    new = law._asdict()
    scaled = {"kp", *free} if not servo.follows_speed else {"damping", *free}
    for name in SCALED:
        if name in scaled and new[name] < OPEN:
            new[name] *= factor
    for name, z in steps.items():
        if name in LOGARITHMIC:
            new[name] *= float(np.exp(z))
        else:
            new[name] += z * scales.unit(name)
    return clip_law(servo, scales, ServoLaw(**new), free)


def ranges(servo: Servo) -> dict[str, tuple[float, float]]:
    """Least and largest value of the numbers that have one."""
    return {
        "rub": (0.0, np.inf),
        "delay": (0.0, CLOSED_LOOP.history - 0.02),
        "lag": (0.0, 0.5),
        "rotor": (-servo.armature, np.inf),
        "payload": (0.0, np.inf),  # a mass that is missing leaves a body that cannot be
        "lift": (-1.0, 2.0),
        "offset": (-0.3, 0.3),
        "zero": (-0.3, 0.3),
        "damping_delay": (-CLOSED_LOOP.damping_delay, CLOSED_LOOP.damping_delay),
        "shift": (-CLOSED_LOOP.late, CLOSED_LOOP.late),
        "reach": (-0.2 * CLOSED_LOOP.reach, CLOSED_LOOP.reach),
        "spring": (0.0, np.inf),
    }


def clip_law(servo: Servo, scales: Scales, law: ServoLaw, free: tuple[str, ...]) -> ServoLaw:
    """The law with what is fitted of it within its range."""
    new = law._asdict()
    for name, ends in ranges(servo).items():
        if name in free:
            new[name] = float(np.clip(new[name], *ends))
    if "rub" in free and not servo.follows_speed:
        # friction beyond what the servo itself can give is none
        new["rub"] = min(new["rub"], 2.0 * new["kp"] * scales.error)
    return ServoLaw(**new)


def inner_damping(servo: Servo, damping: Any) -> Any:
    """Return the part of a damping that is the controller's: what is beyond the joint's own."""
    return damping - np.minimum(servo.passive, damping)


def stack_laws(laws) -> ServoLaw:
    """Several laws as one of arrays [B]."""
    return ServoLaw(*(np.array(z, float) for z in zip(*laws, strict=True)))


def put_law(servo: Servo, model: mujoco.MjModel, law: ServoLaw) -> None:
    """Put a law into a MuJoCo model, in place, but for delay, lag, payload and lift."""
    g, k, dof = servo.gear, servo.actuator, servo.dof
    inner = law.damping - min(servo.passive, law.damping)
    model.actuator_gainprm[k, 0] = (inner if servo.follows_speed else law.kp) / g
    model.actuator_biasprm[k, :3] = 0.0, -law.kp / g**2, -inner * law.inside / g**2
    model.actuator_dynprm[k, 0] = 1e-9  # targets are filtered before
    model.actuator_actearly[k] = True
    model.dof_damping[dof] = law.damping - inner * law.inside
    model.dof_frictionloss[dof] = law.rub
    rotor = servo.armature + law.rotor - law.damping_delay * law.damping
    bodies = max(1.0 / float(model.dof_invweight0[dof]) - servo.armature, 0.0)
    model.dof_armature[dof] = max(rotor, -MAX_LIGHTENING * bodies)
    model.jnt_stiffness[int(model.dof_jntid[dof])] = law.spring
    model.qpos_spring[servo.qpos] = servo.rest
    if law.sharp:
        model.dof_solref[dof] = SHARP_REFERENCE
        model.dof_solimp[dof] = SHARP_IMPEDANCE
    model.actuator_forcelimited[k] = law.limit < OPEN
    model.actuator_forcerange[k] = np.array([-law.limit, law.limit]) / abs(g)
    model.actuator_ctrllimited[k] = False
