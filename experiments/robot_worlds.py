"""Robots that people have, with one thing that their model file lacks: what `diagnose` names.

    python experiments/robot_worlds.py ROBOTS OUT --robots panda__panda go2 --worlds null friction gain --seed 0

ROBOTS: a folder of MJCF files. Each world is a log made by MuJoCo in steps of 0.5 ms, base welded, without contact: 6 trials of 5 s at
200 Hz, commands of the file's own actuators (sums of sines about `home`), angles with noise of 1e-4 rad. A line of JSON a world:
what was hidden, what was named, seconds.
"""

import argparse
import json
import time
from pathlib import Path

import mujoco
import numpy as np

FINE = 5e-4  # s
NOISE = 1e-4  # rad, m
WORLDS = ("null", "friction", "delay", "gain", "armature", "payload")


def welded(path: Path) -> tuple[mujoco.MjModel, np.ndarray]:
    """The file with its free base fixed at `home`, and the pose [nq] of `home` (its zero, where it has none)."""
    spec = mujoco.MjSpec.from_file(str(path))
    first = spec.compile()
    home = next((k for k in range(first.nkey) if first.key(k).name == "home"), -1)
    q0 = first.qpos0 if home < 0 else first.key_qpos[home]
    for k, joint in enumerate(list(spec.joints)):
        if joint.type == mujoco.mjtJoint.mjJNT_FREE:
            at = first.jnt_qposadr[k]
            joint.parent.pos, joint.parent.quat = q0[at : at + 3], q0[at + 3 : at + 7]
            for sensor in [s for s in spec.sensors if s.objname == joint.name]:
                spec.delete(sensor)
            spec.delete(joint)
    for key in list(spec.keys):
        spec.delete(key)
    model = spec.compile()
    pose = model.qpos0.copy()
    for k in range(model.njnt):
        old = first.joint(model.joint(k).name).id
        pose[model.jnt_qposadr[k]] = q0[first.jnt_qposadr[old]]
    return model, pose


def hidden(model: mujoco.MjModel, pose: np.ndarray, world: str, rng: np.random.Generator) -> dict:
    """Change the model as the world has it, in fine steps without contact; what was changed. A delay [s] is the caller's."""
    driven = [int(model.actuator_trnid[k, 0]) for k in range(model.nu) if model.actuator_trntype[k] == 0]
    model.opt.timestep = FINE
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    heavy = [j for j in driven if model.jnt_type[j] == 3]
    j = int(rng.choice(heavy))
    k = next(k for k in range(model.nu) if model.actuator_trntype[k] == 0 and model.actuator_trnid[k, 0] == j)
    dof, body = int(model.jnt_dofadr[j]), int(model.jnt_bodyid[j])
    out = {"world": world, "joint": model.joint(j).name, "delay": 0.0}
    inertia = 1.0 / max(float(model.dof_invweight0[dof]), 1e-9)
    if world == "friction":
        model.dof_frictionloss[dof] += (size := 3.0 * inertia + 0.5 * abs(weight(model, pose)[dof]))
        out["size"] = float(size)
    elif world == "delay":
        out["delay"] = float(rng.uniform(0.008, 0.02))
    elif world == "gain":
        size = float(rng.choice([0.75, 1.3]))
        model.actuator_gainprm[k] *= size
        model.actuator_biasprm[k, :3] *= size
        out["size"] = size
    elif world == "armature":
        model.dof_armature[dof] += 0.6 * inertia
        out["size"] = 0.6 * inertia
    elif world == "payload":
        last = int(model.jnt_bodyid[heavy[-1]])
        share = float(rng.uniform(0.5, 1.0))
        model.body_mass[last] *= 1.0 + share
        model.body_inertia[last] *= 1.0 + share
        out |= {"joint": model.joint(heavy[-1]).name, "body": model.body(last).name, "size": share}
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return out | {"body": out.get("body", model.body(body).name)}


def weight(model: mujoco.MjModel, pose: np.ndarray) -> np.ndarray:
    """[nv] N m, N: of gravity at a pose."""
    data = mujoco.MjData(model)
    data.qpos[:] = pose
    mujoco.mj_forward(model, data)
    return data.qfrc_bias


def commands(model: mujoco.MjModel, data: mujoco.MjData, rng: np.random.Generator):
    """t -> [nu]: sums of sines about the pose at hand, within the actuators' ranges."""
    servo, limited = model.actuator_biasprm[:, 1] < 0, model.actuator_ctrllimited.astype(bool)
    low, high = model.actuator_ctrlrange.T
    size = np.where(
        limited, np.where(servo, np.minimum(0.25 * (high - low), 0.5), 0.12 * (high - low)), np.where(servo, 0.5, 1.0)
    )
    middle = np.where(servo, data.actuator_length, 0.0)
    middle = np.where(limited, np.clip(middle, low + 0.6 * size, high - 0.6 * size), middle)
    speed, phase = rng.uniform(0.2, 1.2, (3, model.nu)), rng.uniform(0, 2 * np.pi, (3, model.nu))
    return lambda t: middle + size / 2 * np.sin(2 * np.pi * speed * t + phase).sum(0)


def record(
    model: mujoco.MjModel, pose: np.ndarray, folder: Path, path: Path, delay: float, rng: np.random.Generator
) -> None:
    """Six trials into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "meta.toml").write_text(f'task = "mechanism"\nmodel = "{path.resolve()}"\n')
    data, every, rate = mujoco.MjData(model), 10, 200
    joint_of = lambda k: model.joint(int(model.actuator_trnid[k, 0])).name
    told_by = lambda k: f"ctrl_{model.actuator(k).name}" if model.actuator(k).name else f"target_{joint_of(k)}"
    names = [f"q_{model.joint(k).name}" for k in range(model.njnt)] + [told_by(k) for k in range(model.nu)]
    for trial in range(6):
        mujoco.mj_resetData(model, data)
        data.qpos[:] = pose
        mujoco.mj_forward(model, data)
        told = commands(model, data, rng)
        rows = []
        for row in range(5 * rate):
            rows.append([row / rate, *(data.qpos + NOISE * rng.standard_normal(model.nq)), *told(row / rate)])
            for step in range(every):
                data.ctrl[:] = told(np.floor((row / rate + step * FINE - delay) * rate + 1e-9) / rate)
                mujoco.mj_step(model, data)
        np.savetxt(
            folder / f"run_{trial}.csv", rows, delimiter=",", header=",".join(["time", *names]), comments="", fmt="%.9g"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--robots", nargs="+", required=True)
    parser.add_argument("--worlds", nargs="+", default=list(WORLDS), choices=WORLDS)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    from adaptsim_jax.attribution.diagnose import diagnose
    from adaptsim_jax.core import compile_flags

    compile_flags.small_steps()
    for robot in args.robots:
        (path,) = [p for p in sorted(args.folder.glob("*.xml")) if p.stem == robot or p.stem.endswith(robot)][:1]
        for world in args.worlds:
            rng = np.random.default_rng([args.seed, WORLDS.index(world), sum(map(ord, robot))])
            model, pose = welded(path)
            truth = hidden(model, pose, world, rng)
            data = args.out / f"{robot}_{world}_{args.seed}"
            record(model, pose, data, path, truth["delay"], rng)
            began = time.monotonic()
            try:
                report = diagnose(data, out=data / "out")
                found = {"verdict": report["verdict"], "message": report["message"], "error": report["error"]}
            except Exception as error:  # a study goes on, and says so
                found = {"failed": f"{type(error).__name__}: {error}"}
            print(
                json.dumps({"robot": robot} | truth | found | {"seconds": round(time.monotonic() - began, 1)}),
                flush=True,
            )


if __name__ == "__main__":
    main()
