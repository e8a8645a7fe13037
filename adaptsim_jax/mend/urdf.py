"""Links and joints of a URDF from a compiled model."""

from typing import Any

import mujoco
import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.mechanisms.mjcf import rotation_of

TYPES = {
    int(mujoco.mjtJoint.mjJNT_HINGE): "revolute",
    int(mujoco.mjtJoint.mjJNT_SLIDE): "prismatic",
}
OPEN = 1e9  # N m: URDF asks for a limit where nothing bounds a drive


def urdf_parts(model: mujoco.MjModel) -> dict[str, list[dict[str, Any]]]:
    """`links` and `joints` for the template. A link's frame is where its last joint is; a body of
    several joints has a weightless link before each but the last. BadInput where a joint is a ball
    or free.
    """
    links: list[dict[str, Any]] = [{"name": "world", "mass": 0.0}]
    joints: list[dict[str, Any]] = []
    shift = {0: np.zeros(3)}  # of a body's link in the body's frame
    for b in range(1, model.nbody):
        name, parent = model.body(b).name, int(model.body_parentid[b])
        joint_numbers = range(model.body_jntadr[b], model.body_jntadr[b] + model.body_jntnum[b])
        at, turn = model.body_pos[b] - shift[parent], rotation_of(model.body_quat[b])
        above, last = model.body(parent).name, np.zeros(3)
        for j in joint_numbers:
            place = model.jnt_pos[j]
            link = name if j == joint_numbers[-1] else f"{name}_{model.joint(j).name}"
            row = {"parent": above, "child": link, "at": at + turn @ (place - last)}
            joints.append(row | {"turn": _angles(turn)} | _joint(model, j))
            if link != name:
                links.append({"name": link, "mass": 0.0})
            above, at, turn, last = link, np.zeros(3), np.eye(3), place
        if not len(joint_numbers):
            row = {"name": f"{name}_fixed", "type": "fixed", "parent": above, "child": name}
            joints.append(row | {"at": at, "turn": _angles(turn)})
        shift[b] = last
        axes = rotation_of(model.body_iquat[b])
        inertia = axes @ np.diag(model.body_inertia[b]) @ axes.T
        com = model.body_ipos[b] - last
        links.append({"name": name, "mass": model.body_mass[b], "com": com, "inertia": inertia})
    return {"links": links, "joints": joints}


def _joint(model: mujoco.MjModel, j: int) -> dict[str, Any]:
    name, dof = model.joint(j).name, model.jnt_dofadr[j]
    kind = TYPES.get(int(model.jnt_type[j]))
    if kind is None:
        raise BadInput(
            f"--as urdf: joint '{name}' is a ball or free, which URDF has not; export to mjcf"
        )
    zero = model.qpos0[model.jnt_qposadr[j]]  # an encoder's offset, which URDF has not
    limits = {"effort": _effort(model, j), "velocity": OPEN}
    if model.jnt_limited[j]:
        limits |= dict(zip(("lower", "upper"), model.jnt_range[j] - zero, strict=True))
    elif kind == "revolute":
        kind = "continuous"
    else:
        limits |= {"lower": -OPEN, "upper": OPEN}
    numbers = {"damping": model.dof_damping[dof], "friction": model.dof_frictionloss[dof]}
    return {"name": name, "type": kind, "axis": model.jnt_axis[j], "limits": limits} | numbers


def _effort(model: mujoco.MjModel, j: int) -> float:
    """N m that the drives of a joint give at most."""
    limits = [OPEN]
    if model.jnt_actfrclimited[j]:
        limits.append(np.abs(model.jnt_actfrcrange[j]).max())
    for k in range(model.nu):
        if model.actuator_trnid[k, 0] == j and model.actuator_forcelimited[k]:
            limits.append(np.abs(model.actuator_forcerange[k] * model.actuator_gear[k, 0]).max())
    return float(min(limits))


def _angles(turn: np.ndarray) -> np.ndarray:
    """Roll, pitch and yaw of a rotation."""
    pitch = np.arctan2(-turn[2, 0], np.hypot(turn[0, 0], turn[1, 0]))
    return np.array([np.arctan2(turn[2, 1], turn[2, 2]), pitch, np.arctan2(turn[1, 0], turn[0, 0])])
