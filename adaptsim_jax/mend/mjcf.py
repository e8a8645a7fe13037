"""A user's model file with other numbers in it: fitted inertias, friction, gains. URDF in gives
MJCF out. What other rooms change in a file goes through `edited`, too.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import mujoco
import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.mechanisms.inertia_frames import central, in_frame, inertial_about, inverse
from adaptsim_jax.mechanisms.mjcf import Mechanism, rotation_of
from adaptsim_jax.mechanisms.spec import compiled, read_source, read_spec, without_shapes

MIN_MOMENT = 1e-9  # kg m^2
FAR = 1e4  # rad: no joint gets there
MARK = "adaptsim"


@dataclass(frozen=True)
class Changes:
    """What to put in; None, or a joint that a table does not name, stays as it is.

    inertial [n, 10] as of `Tree`; joint tables {joint name: value}: damping, armature, frictionloss
    (N m), stiffness (N m/rad), springref (rad), drag (N m s^2/rad^2), ref
    (rad, what its encoder reads more); stops {joint name: (N m/rad, rad, side)}: ends as springs of
    tendons; gravity [3] m/s^2 in the world; actuator tables
    {actuator name: value}: gain, kp and speed (what a speed servo makes of its command) as factors,
    kv (N m s/rad), delay and lag in s, limit (N m), bias (N m); lift: share of gravity that all
    bodies are compensated for; motors {joint name: N m per unit of its command} are put in where
    the joint has no actuator, with the limit under `limit` by the joint's name; comments: what the
    file cannot hold, a line each; lost: the same as `EFFECT at JOINT`, by which the file is marked
    as one that has what was found (None: it is not).
    """

    inertial: np.ndarray | None = None
    joints: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    gravity: np.ndarray | None = None
    actuators: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    motors: Mapping[str, float] = field(default_factory=dict)
    comments: Sequence[str] = ()
    lift: float | None = None
    stops: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    lost: Sequence[str] | None = None


def mended_mjcf(mechanism: Mechanism, changes: Changes) -> str:
    """The model file as MJCF text with `changes` in it. Without its shapes where their meshes are
    not there, as it was read.

    Raises BadInput where MuJoCo refuses the result.
    """
    try:
        return _mended(mechanism, changes)
    except BadInput:
        note = (
            "written without shapes, sensors and keys: the meshes that this file names could not "
            "be read"
        )
        return _mended(
            mechanism, replace(changes, comments=[*changes.comments, note]), shapes=False
        )


def _mended(mechanism: Mechanism, changes: Changes, shapes: bool = True) -> str:
    def edit(spec: mujoco.MjSpec) -> Sequence[str]:
        if not shapes:
            without_shapes(spec)
        _put_all(spec, mechanism, changes)
        if changes.lost is not None:
            spec.add_text(name=MARK, data="; ".join(changes.lost) or "nothing lost")
        return changes.comments

    return edited(mechanism.path, edit)


def edited(path: str | os.PathLike, edit: Callable[[mujoco.MjSpec], Sequence[str]]) -> str:
    """The model file at `path` as MJCF text after `edit(spec)`, which returns lines to stand above
    it as comments. Every file that is mended is written here.

    Raises BadInput where MuJoCo refuses the result.
    """
    spec, _ = read_spec(path)
    _with_whole_folders(spec, Path(path).resolve().parent)
    comments = edit(spec)
    compiled(str(path), spec)
    return commented(spec.to_xml(), comments)


def _with_whole_folders(spec: mujoco.MjSpec, folder: Path) -> None:
    """Name the folders of meshes and textures whole, so that the text compiles wherever it lies."""
    if spec.meshes or spec.hfields or spec.skins:
        spec.meshdir = str(folder / spec.meshdir)
    if spec.textures:
        spec.texturedir = str(folder / spec.texturedir)


def _put_all(spec: mujoco.MjSpec, mechanism: Mechanism, changes: Changes) -> None:
    if changes.inertial is not None:
        _put_inertias(spec, mechanism, np.asarray(changes.inertial))
    for joint in spec.joints:
        for key, table in changes.joints.items():
            if joint.name in table:
                _put_joint(spec, mechanism, joint, key, float(table[joint.name]))
    for name, stop in changes.stops.items():
        _put_stop(spec, name, *stop)
    if changes.gravity is not None:
        spec.option.gravity = np.asarray(changes.gravity, float)
    for body in spec.bodies[1:]:
        body.gravcomp = body.gravcomp if changes.lift is None else changes.lift
    _put_actuators(spec, changes)


def _put_actuators(spec: mujoco.MjSpec, changes: Changes) -> None:
    for joint, gear in changes.motors.items():
        motor = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_motor()
        motor.gear = [gear, *[0.0] * 5]
        if joint in changes.actuators.get("limit", {}):
            _put_actuator(motor, "limit", changes.actuators["limit"][joint] / gear, 0.0)
    step = float(spec.option.timestep)
    for actuator in spec.actuators:
        for key, table in changes.actuators.items():
            if actuator.name in table and actuator.name not in changes.motors:
                _put_actuator(actuator, key, float(table[actuator.name]), step)


def _put_joint(spec: mujoco.MjSpec, mechanism: Mechanism, joint, key: str, value: float) -> None:
    tree = mechanism.tree
    is_in_degrees = joint.type == mujoco.mjtJoint.mjJNT_HINGE and spec.compiler.degree
    angle = float(np.rad2deg(value)) if is_in_degrees else value
    if key == "springref":
        put_field(joint, key, angle)
    elif key == "ref":  # all that is told by the encoder goes along
        joint.ref, joint.springref = joint.ref + angle, joint.springref + angle
        joint.range = joint.range + angle
    elif key == "drag":
        joint.damping[1] = value
    elif joint.name in tree.joint_names:
        # what followers, tendons and actuators add stays with them
        file_value = np.asarray(getattr(tree, key))[tree.joint_names.index(joint.name)]
        change, current = value - float(file_value), float(np.ravel(getattr(joint, key))[0])
        put_field(joint, key, value if change + current == value else max(0.0, current + change))


def _put_stop(spec: mujoco.MjSpec, joint: str, stiffness: float, angle: float, side: float) -> None:
    """A spring beyond an angle: that of a tendon which is slack before it."""
    tendon = spec.add_tendon(name=f"stop_{joint}", stiffness=[stiffness, 0.0, 0.0])
    tendon.wrap_joint(joint, 1.0)
    tendon.springlength = [-FAR, angle] if side > 0.0 else [angle, FAR]


def _put_actuator(actuator, key: str, value: float, step: float) -> None:
    gain, bias = np.array(actuator.gainprm), np.array(actuator.biasprm)
    if key in ("gain", "kp"):
        gain[0] *= value
        bias[:2] *= value
        bias[2] *= value if key == "gain" else 1.0
        actuator.gainprm, actuator.biasprm = gain, bias
    elif key == "kv":
        bias[2] = -value
        actuator.biasprm = bias
    elif key == "speed":
        gain[0] *= value
        actuator.gainprm = gain
    elif key == "bias":
        bias[0] += value
        actuator.biasprm = bias
    elif key == "limit":
        actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
        actuator.forcerange = [-value, value]
    elif key == "delay":
        put_delay(actuator, value, step)
    elif key == "lag":
        actuator.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
        dyn = np.array(actuator.dynprm)
        dyn[0] = value
        actuator.dynprm = dyn
    else:
        raise ValueError(f"an actuator has no {key}")


def lost_of(model: mujoco.MjModel) -> list[str] | None:
    """What a file that has what was found does not hold, None of any other file."""
    k = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TEXT, MARK)
    if k < 0:
        return None
    first = int(model.text_adr[k])
    text = bytes(model.text_data)[first : first + int(model.text_size[k]) - 1]
    return text.decode().split("; ")


def put_delay(actuator, delay: float, step: float) -> None:
    """Have commands of an actuator arrive `delay` s late, in a simulation of steps of `step` s."""
    actuator.delay = delay
    actuator.nsample = int(np.ceil(delay / step)) + 2


def put_inertia(body, mass: float, centre, quaternion, moments) -> None:
    """Declare a body's inertia: kg, m, the axes of its moments, kg m^2."""
    body.explicitinertial = True
    body.mass, body.ipos, body.iquat, body.inertia = mass, centre, quaternion, moments
    body.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    body.fullinertia = [np.nan, 0, 0, 0, 0, 0]


def put_field(element, name: str, value) -> None:
    """A number or numbers of an element; fewer than it has are its first."""
    now = np.asarray(getattr(element, name))
    if now.ndim:
        value = np.ravel(value)
        value = np.concatenate([value, now.ravel()[value.size :]])[: now.size]
    setattr(element, name, value)


def _put_inertias(spec, mechanism: Mechanism, inertial: np.ndarray) -> None:
    """Each joint's body gets what is left of its inertia once the bodies that are part of it have
    theirs: those that are welded to it become part of it, those behind a joint that is held keep
    their own.
    """
    tree, frames = mechanism.tree, mechanism.frames
    held_bodies = _held_bodies(mechanism)
    for j, name in enumerate(tree.body_names):
        if tree.massless[j] or np.allclose(inertial[j], tree.inertial[j], rtol=0, atol=0):
            continue
        carried = {b for b, joint in frames.carrier.items() if joint == j and b != name}
        welded = [b for b in spec.bodies if b.name in carried and b.name not in held_bodies]
        held_inertias = [held_bodies[b] for b in held_bodies if b in carried]
        remaining = inertial[j] - sum(held_inertias, np.zeros(10))
        if not _is_possible(remaining):
            continue
        for other in welded:  # welded bodies become part of the one that moves them
            other.explicitinertial = True
            other.mass, other.inertia, other.fullinertia = 0.0, [0.0] * 3, [np.nan, 0, 0, 0, 0, 0]
            for geom in other.geoms:
                geom.mass, geom.density = 0.0, 0.0
        body = next(b for b in spec.bodies if b.name == name)
        mass, com, about = central(
            in_frame(remaining, inverse((frames.place[name], frames.rotation[name])))
        )
        value, vector = np.linalg.eigh(0.5 * (about + about.T))
        value = np.maximum(value, MIN_MOMENT)
        # rounding must not break the triangle inequality
        value[-1] = min(value[-1], value[0] + value[1])
        if np.linalg.det(vector) < 0:
            vector[:, 0] *= -1.0
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, vector.ravel())
        put_inertia(body, mass, com, quaternion, value)


def _held_bodies(mechanism: Mechanism) -> dict[str, np.ndarray]:
    """Bodies behind joints that are held, which must go on weighing something: inertial parameters
    [10] in their joint's frame.
    """
    held = mechanism.roles.held if mechanism.roles is not None else {}
    if not held:
        return {}
    model, frames = read_source(mechanism.path).model, mechanism.frames
    behind: set[str] = set()
    out = {}
    for b in range(1, model.nbody):
        name, up = model.body(b).name, model.body(int(model.body_parentid[b])).name
        joint_numbers = range(model.body_jntadr[b], model.body_jntadr[b] + model.body_jntnum[b])
        joints_of_body = [model.joint(k).name for k in joint_numbers]
        if any(k not in held for k in joints_of_body) or not (joints_of_body or up in behind):
            continue
        behind.add(name)
        place, turn = frames.place[name], frames.rotation[name]
        centre = place + turn @ model.body_ipos[b]
        axes = turn @ rotation_of(model.body_iquat[b])
        out[name] = inertial_about(model.body_mass[b], centre, axes, model.body_inertia[b])
    return out


def _is_possible(inertial: np.ndarray) -> bool:
    """Whether a body may have such inertial parameters."""
    if inertial[0] <= 0.0:
        return False
    return bool(np.linalg.eigvalsh(central(inertial)[2]).min() > -MIN_MOMENT)


def commented(xml: str, comments: Sequence[str]) -> str:
    """MJCF text below XML comments, a line each."""
    lines = [f"<!-- {line.replace('--', '- -')} -->" for line in comments]
    if lines:
        return "\n".join([*lines, xml])
    return xml
