"""The model that is stepped: the user's file, its base welded where no pose of it was logged, and
held what stands still.

A joint that nothing was logged of is held where `assign_roles` has it. One in a loop that closes,
or tied to others, moves as the model says.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.log import Log
from adaptsim_jax.mechanisms.roles import (
    BALL,
    CONNECT,
    FREE,
    JOINT_EQUALITY,
    WELD,
    pose_of,
    upwards,
)
from adaptsim_jax.mechanisms.spec import Source, read_spec, shapeless
from adaptsim_jax.mechanisms.switches import has_off
from adaptsim_jax.simulators.mujoco.sensed import Reading, has_imu, readings

STIFF = (1e-4, 1.0)
HARD = (0.9999, 0.9999, 0.001, 0.5, 2.0)


@dataclass(frozen=True)
class SteppedModel:
    """A model to be stepped.

    Args:
        angle: [n] where each joint of the log is in qpos.
        base: First of the seven of a free base in qpos that was logged, -1: none.
        free: The same of one that moves, logged or only estimated from an IMU.
        sensors: Those that `[channels]` compares.
        pose: [nq] where everything is held or begins.
        notes: What was done, a sentence each.
    """

    path: str
    model: mujoco.MjModel
    angle: np.ndarray
    base: int
    pose: np.ndarray
    notes: tuple[str, ...]
    free: int = -1
    sensors: tuple[Reading, ...] = ()

    def with_model(self, model: mujoco.MjModel) -> "SteppedModel":
        """Return a copy with another model."""
        return replace(self, model=model)


def turns_of_balls(source: Source, log: Log) -> list[str]:
    """Angles of a log that are one of a ball joint's three turns, which MuJoCo's own coordinates
    have not.
    """
    joints = {source.model.joint(k).name for k in range(source.model.njnt)}
    return [name for name in log.joint_names if name not in joints]


def make_stepped_model(
    source: Source, log: Log, prepare: Callable[[mujoco.MjSpec], None] | None = None
) -> SteppedModel:
    """Build the model of a file for a log of it. prepare: changes its spec before it is compiled.

    Raises BadInput where MuJoCo refuses it.
    """
    spec, _ = read_spec(source.path)
    has_base = any(t.base is not None for t in log.trials)
    if has_base and (without_base := [t.name for t in log.trials if t.base is None]):
        raise BadInput(
            f"{log.path}: trial {without_base[0]} has no base_x .. base_qz, which others have; add "
            f"them, or leave it out: [trials] in "
            f'meta.toml, exclude = ["{without_base[0]}"]'
        )
    file_model = source.model
    pose, _ = pose_of(file_model)
    values = {
        file_model.joint(k).name: pose[file_model.jnt_qposadr[k] :][:7]
        for k in range(file_model.njnt)
    }
    notes: list[str] = []
    is_felt = not has_base and has_imu(spec, log.meta.channels)
    _weld(spec, values, has_base or is_felt, notes)
    _free_equalities(spec, source)
    _hold(spec, source, log, values, notes)
    _add_mimics(spec, source)
    for key in list(spec.keys):
        spec.delete(key)
    for body in spec.bodies:
        body.simple = False  # its centre of mass may be fitted
    if prepare is not None:
        prepare(spec)
    model = _compile(source.path, spec)
    model.opt.disableflags |= int(
        mujoco.mjtDisableBit.mjDSBL_AUTORESET
    )  # a run that blows up shall be seen
    qpos_of = {model.joint(k).name: int(model.jnt_qposadr[k]) for k in range(model.njnt)}
    free = next(
        (int(model.jnt_qposadr[k]) for k in range(model.njnt) if model.jnt_type[k] == FREE), -1
    )
    if has_base and free < 0:
        notes.append("base_x .. base_qz are not used: the model's base cannot move")
    if turns := turns_of_balls(source, log):
        raise BadInput(
            f"{source.path}: '{turns[0]}' is one turn of a ball joint, which --simulator mujoco "
            "does not read; take tree"
        )
    if is_felt and free >= 0:
        notes.append(
            "no pose of the base is logged: it is estimated with each start from gyro, "
            "accelerometer and feet that stand"
        )
    angle = np.array([qpos_of[name] for name in log.joint_names], int)
    pose = _initial_pose(model, log, values, qpos_of)
    return SteppedModel(
        source.path,
        model,
        angle,
        free if has_base else -1,
        pose,
        tuple(notes),
        free if has_base or is_felt else -1,
        readings(model, log.meta.channels, log.meta.path),
    )


def _free_equalities(spec: mujoco.MjSpec, source: Source) -> None:
    """Switch equalities off one by one where the file disables all, so that the flag is free for
    those that hold joints.
    """
    bits, flags = mujoco.mjtDisableBit, spec.option.disableflags
    if not has_off(source.model, "equality"):
        return
    for equality in spec.equalities:
        equality.active = False
    others = bits.mjDSBL_FRICTIONLOSS | bits.mjDSBL_LIMIT | bits.mjDSBL_CONTACT
    if flags & bits.mjDSBL_CONSTRAINT:
        flags |= int(others)
    spec.option.disableflags = flags & ~int(bits.mjDSBL_CONSTRAINT | bits.mjDSBL_EQUALITY)


def _add_mimics(spec: mujoco.MjSpec, source: Source) -> None:
    """Add a stiff equality for each joint of a URDF that mimics another."""
    for mimic in source.mimics:
        tie = spec.add_equality(
            name=f"mimic_{mimic.joint}",
            type=mujoco.mjtEq.mjEQ_JOINT,
            name1=mimic.joint,
            name2=mimic.leader,
        )
        data = np.zeros(len(tie.data))
        data[:2] = mimic.offset, mimic.factor
        tie.data, tie.solref, tie.solimp = data, STIFF, HARD


def _initial_pose(model: mujoco.MjModel, log: Log, values, qpos_of: dict[str, int]) -> np.ndarray:
    """The pose [nq] at which everything is held or begins. at: place of each joint in it."""
    pose = model.qpos0.copy()
    for k in range(model.njnt):
        adr, width = int(model.jnt_qposadr[k]), {FREE: 7, BALL: 4}.get(int(model.jnt_type[k]), 1)
        pose[adr : adr + width] = values[model.joint(k).name][:width]
    for name, value in log.held.items():
        if value is not None and name in qpos_of:
            pose[qpos_of[name]] = value
    return pose


def _compile(where: str, spec: mujoco.MjSpec) -> mujoco.MjModel:
    """The whole model; without its meshes where their files are missing."""
    try:
        return spec.compile()
    except Exception:
        return shapeless(where, spec)


def _weld(spec: mujoco.MjSpec, values, logged: bool, notes: list[str]) -> None:
    """Remove free joints, but for that of the base where its pose was logged."""
    base_found = False
    for joint in list(spec.joints):
        if joint.type != mujoco.mjtJoint.mjJNT_FREE:
            continue
        if logged and not base_found:
            base_found = True
            continue
        body = joint.parent
        place = values[joint.name]
        body.pos, body.quat = place[:3], place[3:7] / np.linalg.norm(place[3:7])
        notes.append(f"welded to the world, as no pose of it is logged: {joint.name}")
        for sensor in [
            s
            for s in spec.sensors
            if s.objname == joint.name and s.objtype == mujoco.mjtObj.mjOBJ_JOINT
        ]:
            spec.delete(sensor)
        spec.delete(joint)


def _hold(spec: mujoco.MjSpec, source: Source, log: Log, values, notes: list[str]) -> None:
    """Add a stiff equality for each joint that stands still."""
    held_joints = []
    turns = turns_of_balls(source, log)
    moved_by_logged = _moved_by_logged(
        source.model, [n for n in (*log.joint_names, *log.meta.hold) if n not in turns]
    )
    for joint in spec.joints:
        name = joint.name
        if (
            joint.type not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
            or name in log.joint_names
        ):
            continue
        value = log.held.get(name)
        if name in moved_by_logged and value is None and name not in log.meta.hold:
            continue
        value = float(values[name][0]) if value is None else value
        zero_position = float(source.model.qpos0[source.model.joint(name).qposadr[0]])
        lock = spec.add_equality(name=f"hold_{name}", type=mujoco.mjtEq.mjEQ_JOINT, name1=name)
        data = np.zeros(len(lock.data))
        data[0] = value - zero_position
        lock.data, lock.solref, lock.solimp = data, STIFF, HARD
        held_joints.append(f"{name} = {value:.4g}")
    if held_joints:
        notes.append(f"held, as no log has them or [hold] says so: {', '.join(held_joints)}")
    if unlogged := sorted(moved_by_logged - set(log.joint_names) - set(log.meta.hold)):
        notes.append(f"not logged, moved by what they are tied to: {', '.join(unlogged)}")


def _moved_by_logged(model: mujoco.MjModel, logged: Collection[str]) -> set[str]:
    """Find joints that a loop, an equality or a tendon couples to a logged one: they need no
    log.
    """
    groups: list[set[int]] = []
    for e in range(model.neq):
        if not model.eq_active0[e]:
            continue
        if model.eq_type[e] == JOINT_EQUALITY:
            groups.append({int(k) for k in (model.eq_obj1id[e], model.eq_obj2id[e]) if k >= 0})
        elif model.eq_type[e] in (CONNECT, WELD):
            ends = [int(model.eq_obj1id[e]), int(model.eq_obj2id[e])]
            if model.eq_objtype[e] == int(mujoco.mjtObj.mjOBJ_SITE):
                ends = [int(model.site_bodyid[k]) for k in ends]
            bodies = set(upwards(model, ends[0])) ^ set(upwards(model, ends[1]))
            groups.append({k for k in range(model.njnt) if int(model.jnt_bodyid[k]) in bodies})
    for t in range(model.ntendon):
        rows = range(model.tendon_adr[t], model.tendon_adr[t] + model.tendon_num[t])
        joint = int(mujoco.mjtWrap.mjWRAP_JOINT)
        groups.append({int(model.wrap_objid[w]) for w in rows if model.wrap_type[w] == joint})
    joints = {model.joint(name).id for name in logged}
    while further := [g for g in groups if g & joints and not g <= joints]:
        joints = joints.union(*further)
    return {model.joint(k).name for k in joints}
