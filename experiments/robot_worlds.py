"""Robots that people have, with one thing that their model file lacks: what `diagnose` names.

    python experiments/robot_worlds.py ROBOTS OUT --robots panda__panda go2 --worlds null \\
        friction gain --seed 0

ROBOTS: a folder of MJCF files. Each world is a log made by MuJoCo in steps of 0.5 ms, base welded,
without contact: 6 trials of 5 s at 200 Hz, commands of the file's own actuators (sums of sines
about `home`), angles with noise of 1e-4 rad. A joint and a size are drawn anew until what is hidden
moves the angles by five times the noise. A line of JSON a world: what was hidden, how much it
moves, what was named, whether that is right, seconds.
"""

import argparse
import json
import time
from pathlib import Path

import mujoco
import numpy as np

FINE = 5e-4  # s
NOISE = 1e-4  # rad, m
WORLDS = ("null", "friction", "delay", "gain", "armature", "payload", "offset")
SHOWS = 5.0  # times the noise, rms over a trial and over the joint that it moves most
DRAWS = 20
NAMES = {
    "friction": ("coulomb",),
    "delay": ("delay",),
    "gain": ("torque_gain", "position_gain"),
    "armature": ("armature",),
    "offset": ("encoder_offset",),
    "payload": ("inertia",),
    "null": (),
}


def welded(path: Path) -> tuple[mujoco.MjModel, np.ndarray]:
    """The file with its free base fixed at `home`, and the pose [nq] of `home` (its zero, where it
    has none).
    """
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
    """Change the model as the world has it, in fine steps without contact; what was changed. A
    delay [s] is the caller's.
    """
    driven = [
        int(model.actuator_trnid[k, 0]) for k in range(model.nu) if model.actuator_trntype[k] == 0
    ]
    model.opt.timestep = FINE
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    heavy = [j for j in driven if model.jnt_type[j] == 3]
    j = int(rng.choice(heavy))
    k = next(
        k
        for k in range(model.nu)
        if model.actuator_trntype[k] == 0 and model.actuator_trnid[k, 0] == j
    )
    dof, body = int(model.jnt_dofadr[j]), int(model.jnt_bodyid[j])
    out = {"world": world, "joint": model.joint(j).name, "delay": 0.0, "offset": 0.0}
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
    elif world == "offset":
        out["offset"] = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.02, 0.05))
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
        limited,
        np.where(servo, np.minimum(0.25 * (high - low), 0.5), 0.12 * (high - low)),
        np.where(servo, 0.5, 1.0),
    )
    middle = np.where(servo, data.actuator_length, 0.0)
    middle = np.where(limited, np.clip(middle, low + 0.6 * size, high - 0.6 * size), middle)
    speed, phase = rng.uniform(0.2, 1.2, (3, model.nu)), rng.uniform(0, 2 * np.pi, (3, model.nu))
    return lambda t: middle + size / 2 * np.sin(2 * np.pi * speed * t + phase).sum(0)


def drawn(
    path: Path, world: str, rng: np.random.Generator
) -> tuple[mujoco.MjModel, np.ndarray, dict]:
    """A model with something hidden in it that shows, its pose, and what it is."""
    for _ in range(DRAWS):
        plain, pose = welded(path)
        hidden(plain, pose, "null", np.random.default_rng(0))
        model, pose = welded(path)
        truth = hidden(model, pose, world, rng)
        if world == "null":
            return model, pose, truth
        seed = int(rng.integers(2**31))
        one, other = (
            simulated(m, pose, how, np.random.default_rng(seed))[0]
            for m, how in ((plain, truth | {"delay": 0.0, "offset": 0.0}), (model, truth))
        )
        moved = (other - one) - (other - one).mean(0)  # where an encoder's zero is nobody sees
        truth["shows"] = round(float(np.sqrt(np.square(moved).mean(0)).max()) / NOISE, 1)
        if truth["shows"] >= SHOWS:
            return model, pose, truth
    raise SystemExit(f"{path.name}: no {world} of {DRAWS} shows")


def at_joint(model: mujoco.MjModel, joint: str) -> int:
    return int(model.joint(joint).qposadr[0])


def simulated(model: mujoco.MjModel, pose: np.ndarray, truth: dict, rng: np.random.Generator):
    """Angles [T, nq] as encoders read them and commands [T, nu] of a trial; controllers see what
    encoders read.
    """
    data, every, rate = mujoco.MjData(model), 10, 200
    data.qpos[:] = pose
    mujoco.mj_forward(model, data)
    told = commands(model, data, rng)
    at = at_joint(model, truth["joint"])
    data.qpos[at] -= truth["offset"]
    mujoco.mj_forward(model, data)
    own = [
        k
        for k in range(model.nu)
        if model.actuator_trntype[k] == 0 and model.jnt_qposadr[model.actuator_trnid[k, 0]] == at
    ]
    read = np.zeros(model.nu)
    # a servo moves the joint to where its encoder reads right
    read[own] = truth["offset"] * (model.actuator_biasprm[own, 1] < 0)
    angles, orders = [], []
    for row in range(5 * rate):
        angles.append(data.qpos.copy())
        angles[-1][at] += truth["offset"]
        orders.append(told(row / rate))
        for step in range(every):
            data.ctrl[:] = (
                told(np.floor((row / rate + step * FINE - truth["delay"]) * rate + 1e-9) / rate)
                - read
            )
            mujoco.mj_step(model, data)
    return np.array(angles), np.array(orders)


def judged(report: dict, truth: dict) -> tuple[bool, list[str]]:
    """Whether what is hidden is named (a class that holds it counts), and the names that do not
    hold it.
    """
    wanted, where = NAMES[truth["world"]], (truth["joint"], "all joints", "every joint")

    def holds(name, at):
        return name.replace(" ", "_") in wanted and (truth["world"] == "delay" or at in where)

    rows = [
        [(row["name"], row["where"]), *(a.partition("@")[::2] for a in row["alternatives"])]
        for row in report["effects"]
    ]
    good = [any(holds(*name) for name in row) for row in rows]
    wrong = [
        f"{row[0][0]} at {row[0][1]}" for row, right in zip(rows, good, strict=True) if not right
    ]
    unlike = [n for n in report["notes"] if n.startswith("Unlike the model file")]
    payload = truth["world"] == "payload" and any(
        truth["body"] in n or truth["joint"] in n for n in unlike
    )
    return any(good) or payload or (truth["world"] == "null" and not wrong), wrong


def record(
    model: mujoco.MjModel,
    pose: np.ndarray,
    folder: Path,
    path: Path,
    truth: dict,
    rng: np.random.Generator,
) -> None:
    """Six trials into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "meta.toml").write_text(f'task = "mechanism"\nmodel = "{path.resolve()}"\n')

    def joint_of(k):
        return model.joint(int(model.actuator_trnid[k, 0])).name

    def told_by(k):
        return (
            f"ctrl_{model.actuator(k).name}" if model.actuator(k).name else f"target_{joint_of(k)}"
        )

    names = [f"q_{model.joint(k).name}" for k in range(model.njnt)] + [
        told_by(k) for k in range(model.nu)
    ]
    for trial in range(6):
        angles, orders = simulated(model, pose, truth, rng)
        angles = angles + NOISE * rng.standard_normal(angles.shape)
        rows = np.column_stack([np.arange(len(angles)) / 200, angles, orders])
        np.savetxt(
            folder / f"run_{trial}.csv",
            rows,
            delimiter=",",
            header=",".join(["time", *names]),
            comments="",
            fmt="%.9g",
        )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--robots", nargs="+", required=True)
    parser.add_argument("--worlds", nargs="+", default=list(WORLDS), choices=WORLDS)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    from adaptsim_jax.attribution.diagnose import diagnose
    from adaptsim_jax.core import process

    process.small_steps()
    for robot in args.robots:
        (path,) = [
            p
            for p in sorted(args.folder.glob("*.xml"))
            if p.stem == robot or p.stem.endswith(robot)
        ][:1]
        for world in args.worlds:
            rng = np.random.default_rng([args.seed, WORLDS.index(world), sum(map(ord, robot))])
            model, pose, truth = drawn(path, world, rng)
            data = args.out / f"{robot}_{world}_{args.seed}"
            record(model, pose, data, path, truth, rng)
            began = time.monotonic()
            try:
                report = diagnose(data, out=data / "out")
                right, wrong = judged(report, truth)
                error = {k: report["error"][k] for k in ("before", "after", "noise_floor")}
                found = {
                    "right": right,
                    "wrong": wrong,
                    "verdict": report["verdict"],
                    "message": report["message"],
                }
                found |= {"error": error, "yardsticks": report["yardsticks"]}
            except Exception as error:  # a study goes on, and says so
                found = {"failed": f"{type(error).__name__}: {error}"}
            print(
                json.dumps(
                    {"robot": robot}
                    | truth
                    | found
                    | {"seconds": round(time.monotonic() - began, 1)}
                ),
                flush=True,
            )


if __name__ == "__main__":
    main()
