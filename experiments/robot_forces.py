"""Robots that people have: forces of each one's tree of joints beside those of MuJoCo's C engine,
at a random pose, speed and command.

    python experiments/robot_forces.py ROBOTS

ROBOTS: a folder of MJCF files. Compared, on the tree's coordinates: mass matrix, bias force, and
what springs, dampers, gravity compensation and actuators do together; without contact, limits, dry
friction and equalities, which act otherwise (as hard friction, as folds). A line a file: the
largest difference over the largest force of each kind.
"""

import sys
from pathlib import Path

import jax
import mujoco
import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.mechanisms import dynamics
from adaptsim_jax.mechanisms.mjcf import Mechanism, read_mechanism
from adaptsim_jax.mechanisms.spec import read_source

OFF = ("CONTACT", "LIMIT", "FRICTIONLOSS", "EQUALITY")
SAME = 1e-8


def of_mujoco(made: Mechanism, q: np.ndarray, v: np.ndarray, ctrl: np.ndarray) -> list[np.ndarray]:
    """Mass matrix, bias and applied force on the tree's coordinates by MuJoCo."""
    model = read_source(made.path).model
    for name in OFF:
        model.opt.disableflags |= int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}"))
    data, roles = mujoco.MjData(model), made.roles
    way = np.zeros((model.nv, made.tree.n))
    place = {name: j for j, name in enumerate(made.tree.joint_names)}
    for k in range(model.njnt):
        name, adr, dof = model.joint(k).name, int(model.jnt_qposadr[k]), int(model.jnt_dofadr[k])
        if name in roles.held:
            data.qpos[adr : adr + len(roles.held[name])] = roles.held[name]
        elif name in place:
            data.qpos[adr], way[dof, place[name]] = q[place[name]], 1.0
        elif name in roles.followers:
            f = roles.followers[name]
            data.qpos[adr], way[dof, place[f.leader]] = (
                f.offset + f.factor * q[place[f.leader]],
                f.factor,
            )
    data.qvel[:], data.ctrl[:] = way @ v, ctrl
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return [
        way.T @ full @ way,
        way.T @ data.qfrc_bias,
        way.T @ (data.qfrc_passive + data.qfrc_actuator),
    ]


def of_tree(
    made: Mechanism, q: np.ndarray, v: np.ndarray, ctrl: dict[str, float]
) -> list[np.ndarray]:
    """The same by the tree and its actuators' laws."""
    tree, drive = made.tree, np.zeros(made.tree.n)

    def within(x, limits):
        return float(np.fmin(np.fmax(x, limits[0]), limits[1]))

    for a in made.actuators:
        ways = ((a.joint, a.gear), *a.more)
        along, rate = sum(g * q[j] for j, g in ways), sum(g * v[j] for j, g in ways)
        force = within(
            a.gain * within(ctrl[a.name], a.ctrlrange) + a.offset - a.kp * along - a.kv * rate,
            a.forcerange,
        )
        for j, g in ways:
            drive[j] += g * force
    drive = np.array([within(x, row) for x, row in zip(drive, made.force_limits, strict=True)])
    held_up = dynamics.compensation(tree, q)
    mass = np.asarray(dynamics.mass_matrix(tree, tree.inertial, q)) + np.diag(tree.armature)
    bias = np.asarray(dynamics.inverse_dynamics(tree, tree.inertial, q, v, None, tree.gravity))
    passive = np.asarray(dynamics.passive_force(tree, q, v)) + (
        0.0 if held_up is None else np.asarray(held_up)
    )
    return [mass, bias, passive + drive]


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    same = total = 0
    for path in sorted(Path(sys.argv[1]).glob("*.xml")):
        try:
            made = read_mechanism(path)
        except BadInput as error:
            print(f"{path.stem}: no tree ({error})", flush=True)
            continue
        rng, model = np.random.default_rng(0), read_source(path).model
        q, v, ctrl = (
            0.3 * rng.normal(size=made.tree.n),
            rng.normal(size=made.tree.n),
            0.1 * rng.normal(size=model.nu),
        )
        told = {model.actuator(k).name: float(ctrl[k]) for k in range(model.nu)}
        pairs = zip(of_tree(made, q, v, told), of_mujoco(made, q, v, ctrl), strict=True)
        off = [float(np.abs(a - b).max() / max(np.abs(b).max(), 1e-6)) for a, b in pairs]
        same, total = same + (max(off) < SAME), total + 1
        beyond = "; ".join((*made.unsupported, *made.unsupported_drives)[:2])
        print(
            f"{path.stem}: {made.tree.n} joints, mass {off[0]:.0e}, bias {off[1]:.0e}, applied "
            f"{off[2]:.0e} {beyond}",
            flush=True,
        )
    print(f"{same} of {total} trees within {SAME:g}")


if __name__ == "__main__":
    main()
