"""What a log has to do with a model: its names, and joints that follow others."""

from __future__ import annotations

from typing import TYPE_CHECKING

from adaptsim_jax.logs.criteria import UNIT
from adaptsim_jax.logs.log import ActuatorName, ModelNames

if TYPE_CHECKING:
    from adaptsim_jax.mechanisms.spec import Source
from dataclasses import replace

import numpy as np

from adaptsim_jax.logs.log import Log, LogTrial

if TYPE_CHECKING:
    from adaptsim_jax.mechanisms.mjcf import Mechanism


def model_names(source: Source) -> ModelNames:
    """The names of a model file: all joints that a log may have, which of them slide, the tree, the
    actuators.
    """
    import mujoco

    from adaptsim_jax.mechanisms.roles import BALL, FREE, JOINTS, TURNS, joint_names, ties

    model = source.model
    joints = joint_names(model)
    tied = ties(source)
    slide = int(mujoco.mjtJoint.mjJNT_SLIDE)
    slides = [model.joint(k).name for k in range(model.njnt) if model.jnt_type[k] == slide]
    parents, ranges, last = [], [], {0: -1}
    acts = not int(model.opt.disableflags) & int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    for b in range(1, model.nbody):
        on = last[int(model.body_parentid[b])]
        for k in range(model.body_jntadr[b], model.body_jntadr[b] + model.body_jntnum[b]):
            for _ in range({BALL: len(TURNS), FREE: 0}.get(int(model.jnt_type[k]), 1)):
                parents.append(on)
                single = acts and model.jnt_limited[k] and model.jnt_type[k] != BALL
                ranges.append(tuple(map(float, model.jnt_range[k])) if single else None)
                on = len(parents) - 1
        last[b] = on
    actuators = []
    for k in range(model.nu):
        trn, target = int(model.actuator_trntype[k]), int(model.actuator_trnid[k, 0])
        moved = [model.joint(target).name] if trn in JOINTS else []
        if trn == int(mujoco.mjtTrn.mjTRN_TENDON):
            rows = range(
                model.tendon_adr[target], model.tendon_adr[target] + model.tendon_num[target]
            )
            own = [w for w in rows if model.wrap_type[w] == int(mujoco.mjtWrap.mjWRAP_JOINT)]
            moved = [model.joint(int(model.wrap_objid[w])).name for w in own]
        moves = tuple(
            dict.fromkeys(
                other for name in moved for other in (name, *tied.get(name, ())) if other in joints
            )
        )
        if trn in JOINTS:
            kind = _kind(model, k)
        elif moves:
            kind = "tendon"
        else:
            kind = "other"
        actuators.append(
            ActuatorName(model.actuator(k).name, moves[0] if moves else "", kind, moves)
        )
    return ModelNames(joints, tuple(slides), tuple(parents), tuple(actuators), tied, tuple(ranges))


def _kind(model, k: int) -> str:
    """motor, position, velocity, general or dcmotor, by an actuator's gain and bias."""
    import mujoco

    gain, bias = model.actuator_gainprm[k], model.actuator_biasprm[k]
    if model.actuator_gaintype[k] == int(mujoco.mjtGain.mjGAIN_DCMOTOR):
        return "dcmotor"
    if not any(bias[:3]):
        return "motor"
    if bias[0] or gain[0] not in (-bias[1], -bias[2]):
        return "general"
    if bias[1]:
        return "position"
    return "velocity"


def followed(log: Log, mechanism: Mechanism) -> Log:
    """The log with the mechanism's joints alone, in its order."""
    joints = mechanism.tree.joint_names
    if joints == log.joint_names:
        return log
    where = {name: j for j, name in enumerate(log.joint_names)}
    at = [where[name] for name in joints]
    if mechanism.roles:
        followers = [f for f in mechanism.roles.followers.values() if f.joint in where]
    else:
        followers = []
    commanded = log.input_kind == "command"

    def trial(t: LogTrial) -> LogTrial:
        u = t.u
        if not commanded and log.input_kind != "none":
            u = t.u[:, at].copy()
            for f in followers:
                u[:, joints.index(f.leader)] += f.factor * t.u[:, where[f.joint]]
        extra = {stem: values[:, at] for stem, values in t.extra.items()}
        return replace(t, q=t.q[:, at], v=None if t.v is None else t.v[:, at], u=u, extra=extra)

    reported, unlike = [], []
    for f in followers:
        own = np.concatenate([t.q[:, where[f.joint]] for t in log.trials])
        led = f.offset + f.factor * np.concatenate([t.q[:, where[f.leader]] for t in log.trials])
        separate, span = np.nanmax(np.abs(own - led)), np.nanmax(own) - np.nanmin(own)
        if separate > UNIT.follower * span:
            reported.append(
                f"{f.joint} does not follow {f.leader} as the model says: by up to {separate:.2g} "
                f"of {span:.2g}; nothing is named at {f.leader}"
            )
            unlike.append(f.leader)
    left = [
        name
        for name in log.joint_names
        if name not in joints and name not in {f.joint for f in followers}
    ]
    if left:
        reported.append(f"angles of joints that are held are not used: {', '.join(left)}")
    if commanded or log.input_kind == "none":
        names = log.input_names
    else:
        names = joints
    driven = tuple(name for name in joints if name in log.driven)
    return replace(
        log,
        joint_names=joints,
        trials=tuple(map(trial, log.trials)),
        input_names=names,
        driven=driven,
        notes=(*log.notes, *reported),
        unlike=tuple(unlike),
    )
