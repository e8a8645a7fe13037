"""The laws that act beside MJX, of what was diagnosed and of what a model file asks of MJX that MJX
ignores.
"""

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np

from adaptsim_jax.attribution.acting import ActingModel, Values, rubs_dry
from adaptsim_jax.attribution.in_mjcf import DRIVES, Columns, columns_of, giving_joints
from adaptsim_jax.attribution.machine import Machine
from adaptsim_jax.core import config
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.effects.base import Effect
from adaptsim_jax.effects.joints.actuator import DELAY
from adaptsim_jax.effects.joints.catalogue import MACHINE
from adaptsim_jax.effects.joints.forces import ARMATURE, SPRING
from adaptsim_jax.effects.joints.friction import COULOMB, VISCOUS
from adaptsim_jax.environments.fields import MIN_FRICTION
from adaptsim_jax.environments.laws import Laws
from adaptsim_jax.mechanisms.tree import Tree, make_tree

IN_MODEL = (VISCOUS, COULOMB, ARMATURE, SPRING)
"""Effects that MJX has in its model, of joints whose drive is rigid."""
SHARP = (0.9999, 0.9999, 0.001, 0.5, 2.0)
"""solimp of dry friction that ends a speed within a step, as of real joints: it gives by 1e-4."""
SOONEST = 0.05  # s: delays that a law may be given later, by a field
SWINGS = 1.0  # rad within a step: a spring that swings faster cannot be stepped explicitly
JOINTS = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))


def laws_of(native: mujoco.MjModel, found: Machine | None, where: str) -> Laws | None:
    """The laws beside MJX at a machine's joints, None where there are none; `native` is made ready
    for them.

    found: What was diagnosed; None: what the file alone asks of MJX and MJX ignores (delays of
    actuators, polynomials of damping and stiffness).
    """
    if found is None:
        tree, columns = _asked(native, where)
    else:
        tree, columns = _bare(found.tree), columns_of(found)
        _sharpened(native, found, columns)
    joints, n = tree.joint_names, tree.n
    giving = giving_joints(columns, n)
    on = tuple(
        e
        for e in MACHINE
        if e.place != "model" and _on(e, columns) and (e not in IN_MODEL or giving.any())
    )
    damping, stiffness = _polynomials(native)
    if not on and damping is None and stiffness is None:
        return None
    qpos, dof, ctrl, act = _places(native, joints, where)
    if found is not None and damping is not None:
        damping[list(dof), 0] = 0.0  # an effect of these joints
    soft = [columns[e.name, "compliance"] > 0.0 for e in on if rubs_dry(e)[1]]
    yielding = np.any([np.zeros(n, bool), *soft], axis=0) & ~giving
    late = [columns[e.name, "delay"] for e in on if (e.name, "delay") in columns]
    longest = max([SOONEST, *(2.0 * float(z.max()) for z in late)])
    laws = Laws(
        ActingModel(tree, on),
        _values(native, tree, ctrl, {e.name: _numbers(e, columns, giving) for e in on}),
        damping,
        stiffness,
        joints,
        qpos,
        dof,
        ctrl,
        act,
        tuple(map(bool, giving)),
        tuple(map(bool, yielding)),
        int(np.ceil(longest / native.opt.timestep)) + 2,
    )
    _check(laws, native, columns, where)
    if laws.rubbing:
        rows = list(dof)
        native.dof_frictionloss[rows] = np.maximum(native.dof_frictionloss[rows], MIN_FRICTION)
    return laws


def _on(effect: Effect, columns: Columns) -> bool:
    """Whether an effect is at any joint."""
    return any(
        np.any(columns[effect.name, p.name] != p.default)
        for p in effect.amplitudes
        if (effect.name, p.name) in columns
    )


def _numbers(effect: Effect, columns: Columns, giving: np.ndarray) -> dict[str, np.ndarray]:
    """Numbers of an effect `[n, 1]` by parameter; of what MJX has, those of joints that give."""
    out = {}
    for p in effect.parameters:
        column = np.asarray(columns.get((effect.name, p.name), np.full(len(giving), p.default)))
        if effect in IN_MODEL and not p.shape:
            column = np.where(giving, column, p.default)
        out[p.name] = column.astype(float)[:, None]
    return out


def _values(native: mujoco.MjModel, tree: Tree, ctrl: Sequence[int], effects) -> Values:
    """Values of the laws, with those of the environment's own actuators."""
    law, gear = np.zeros((6, tree.n), np.float32), np.ones((tree.n, 1), np.float32)
    law[4:] = [[-np.inf], [np.inf]]
    for j, k in enumerate(ctrl):
        if k < 0:
            continue
        gear[j] = native.actuator_gear[k, 0]
        law[:4, j] = native.actuator_gainprm[k, 0], *native.actuator_biasprm[k, :3]
        if native.actuator_forcelimited[k]:
            law[4:, j] = native.actuator_forcerange[k]
    inertial, gravity = (
        np.asarray(z, np.float32)[..., None] for z in (tree.inertial, tree.gravity)
    )
    return Values(inertial, gravity, law[..., None], gear, effects, read=np.zeros((tree.n, 1)))


def _bare(tree: Tree) -> Tree:
    """The tree with nothing held up against gravity, which is MJX's."""
    return replace(tree, all_joints=None, compensated=(False,) * tree.n)


def _asked(native: mujoco.MjModel, where: str) -> tuple[Tree, Columns]:
    """The joints whose actuators the file has late, and how late."""
    late = np.flatnonzero(native.actuator_delay)
    for k in late:
        if int(native.actuator_trntype[k]) not in JOINTS:
            raise BadInput(
                f"{where}: actuator '{native.actuator(k).name}' has a delay, which MJX ignores, "
                "and is at no joint; set its delay to 0, or let it drive a joint"
            )
    joints = [native.actuator_trnid[k, 0] for k in late]
    n, names = len(late), tuple(native.joint(j).name for j in joints)
    tree = make_tree(
        ("hinge",) * n,
        (-1,) * n,
        np.zeros((n, 3)),
        np.tile(np.eye(3), (n, 1, 1)),
        np.zeros((n, 10)),
        joint_names=names,
        body_names=names,
        limited=[False] * n,
    )
    return tree, {(DELAY.name, "delay"): native.actuator_delay[late]}


def _polynomials(native: mujoco.MjModel) -> tuple[np.ndarray | None, np.ndarray | None]:
    """MuJoCo's polynomials of damping `[nv, 2]` and stiffness `[njnt, 2]`, None where none is."""
    names = ("dof_dampingpoly", "jnt_stiffnesspoly")
    both = (np.asarray(getattr(native, name), np.float32) for name in names)
    damping, stiffness = (z if z.any() else None for z in both)
    return damping, stiffness


def _places(native: mujoco.MjModel, joints: Sequence[str], where: str):
    """Where each joint's angle, speed, command and activation are in the environment's model."""
    places = []
    for name in joints:
        j = mujoco.mj_name2id(native, mujoco.mjtObj.mjOBJ_JOINT, name)
        if j < 0:
            known = [native.joint(i).name for i in range(native.njnt)]
            near = config.suggest(name, known)
            raise BadInput(f"{where}: the environment's model has no joint '{name}'; {near}")
        k = actuator_at(native, name, where)
        act = int(native.actuator_actadr[k]) if k >= 0 else -1
        places.append((int(native.jnt_qposadr[j]), int(native.jnt_dofadr[j]), k, act))
    return tuple(zip(*places, strict=True)) or ((), (), (), ())


def actuator_at(native: mujoco.MjModel, joint: str, path: str) -> int:
    """The number of the actuator at a joint, -1 where there is none; BadInput where two are."""
    j, joints = (
        native.joint(joint).id,
        (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT),
    )
    some = [
        k
        for k in range(native.nu)
        if int(native.actuator_trntype[k]) in map(int, joints) and native.actuator_trnid[k, 0] == j
    ]
    if len(some) > 1:
        raise BadInput(
            f"{path}: joint '{joint}' has {len(some)} actuators in the environment's model, and "
            "laws of one are known; join them into one"
        )
    return some[0] if some else -1


def _sharpened(native: mujoco.MjModel, found: Machine, columns: Columns) -> None:
    """Dry friction of joints where some was found ends a speed within a step, unless it gives."""
    dry = [e for e in MACHINE if rubs_dry(e)[0] and _on(e, columns)]
    if found.gives or not dry:
        return
    for name in found.tree.joint_names:
        j = mujoco.mj_name2id(native, mujoco.mjtObj.mjOBJ_JOINT, name)
        if j >= 0:
            dof = native.jnt_dofadr[j]
            native.dof_solref[dof] = 2.0 * native.opt.timestep, 1.0
            native.dof_solimp[dof] = SHARP


def _check(laws: Laws, native: mujoco.MjModel, columns: Columns, where: str) -> None:
    """BadInput where a law cannot act in the environment's model."""
    flags = mujoco.mjtDisableBit
    off = int(flags.mjDSBL_CONSTRAINT) | int(flags.mjDSBL_FRICTIONLOSS)
    if laws.rubbing and native.opt.disableflags & off:
        raise BadInput(
            f"{where}: dry friction was found, and the environment's model has it switched off; "
            "delete <flag constraint> and <flag frictionloss> from its option"
        )
    for e in laws.model.effects:
        amplitudes = [laws.values.effects[e.name][p.name][:, 0] for p in e.amplitudes]
        there = np.any([z != p.default for z, p in zip(amplitudes, e.amplitudes, strict=True)], 0)
        for j in np.flatnonzero(there):
            if e.on_actuator and laws.ctrl[j] < 0:
                raise BadInput(
                    f"{where}: '{e.name}' of {laws.joints[j]} acts on an actuator, and the "
                    "environment's model has none there; add one, or delete the effect"
                )
            if e.place == "command" and amplitudes[0][j] < 0.0:
                raise BadInput(
                    f"{where}: a {e.name} of {amplitudes[0][j]:g} s at {laws.joints[j]}; give 0 or "
                    "more, or delete the effect"
                )
    data, mass = mujoco.MjData(native), np.zeros((native.nv, native.nv))
    mujoco.mj_forward(native, data)
    mujoco.mj_fullM(native, data, mass)
    for j in np.flatnonzero(laws.giving):
        compliance = sum(
            columns.get((e, "compliance"), np.zeros(len(laws.joints)))[j] for e in DRIVES
        )
        swing = native.opt.timestep / np.sqrt(compliance * mass[laws.dof[j], laws.dof[j]])
        if swing > SWINGS:
            raise BadInput(
                f"{where}: the drive of {laws.joints[j]} swings by {swing:.2g} rad in a step of "
                f"the environment's model; give it a timestep of at most "
                f"{native.opt.timestep * SWINGS / swing:.2g} s"
            )
