"""What a reader of logs must know of a model, taken from the model."""

from __future__ import annotations

from typing import TYPE_CHECKING

from adaptsim_jax.logs.log import ActuatorName, ModelNames

if TYPE_CHECKING:
    from adaptsim_jax.mechanisms.spec import Source


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
