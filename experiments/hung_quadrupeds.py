"""Quadrupeds that hang by their trunk, driven by torque, with one thing that their file lacks or
none: made, diagnosed, counted.

    python experiments/hung_quadrupeds.py ROBOTS OUT --seed 1

ROBOTS: a folder of MJCF files. Motors are held by a controller at 200 Hz and their torques are
logged. Swings of 0.25 rad below 1.2 Hz, 6 trials of 5 s at 200 Hz, noise of 0.3 mrad. Ten worlds
lack a dry friction, a rotor or a delay at one joint, four nothing. A line of JSON a world; a last
line of how many names are right and wrong.
"""

import argparse
import json
import time
from pathlib import Path

import mujoco
import numpy as np

ROBOTS = ("unitree_go1__go1", "unitree_go2__go2", "anybotics_anymal_c__anymal_c")
WORLDS = ("friction", "rotor", "delay", "friction", "rotor", "delay", "friction", "rotor", "delay")
NAMES = {"friction": "coulomb", "rotor": "armature", "delay": "delay", "null": ""}
NOISE, ROW, FINE, SWING, FASTEST = 3e-4, 5e-3, 5e-4, 0.25, 1.2  # rad, s, s, rad, Hz
TRIALS, SECONDS, FAST = 6, 5.0, 30.0  # FAST: rad/s of the controller


def hung(path: Path) -> mujoco.MjSpec:
    """The file without what makes its trunk free, without contact and actuators but motors."""
    spec = mujoco.MjSpec.from_file(str(path))
    for joint in list(spec.joints):
        if joint.type == mujoco.mjtJoint.mjJNT_FREE:
            spec.delete(joint)
    for every in (spec.keys, spec.actuators, spec.sensors):
        for one in list(every):
            spec.delete(one)
    for joint in spec.joints:
        motor = spec.add_actuator(name=joint.name, target=joint.name)
        motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
        motor.set_to_motor()
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    spec.option.timestep = FINE
    return spec


def usual_torque(model: mujoco.MjModel, home: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Torques [nv] that swings about `home` need, root mean square over 50 poses."""
    data, torques = mujoco.MjData(model), []
    fastest = SWING * (np.pi * FASTEST) ** 2 / model.dof_invweight0
    for _ in range(50):
        data.qpos[:] = home + SWING * rng.uniform(-1.0, 1.0, model.nv)
        mujoco.mj_forward(model, data)
        torques.append(data.qfrc_bias + fastest * rng.uniform(-1.0, 1.0, model.nv))
    return np.sqrt(np.mean(np.square(torques), 0))


def with_hidden(
    model: mujoco.MjModel, world: str, usual: np.ndarray, rng: np.random.Generator
) -> dict:
    """Put what is hidden into the model; what it is. A delay [rows] is the caller's. usual: torques
    [nv] N m; a friction is a part of them, so that the joint still moves.
    """
    j = int(rng.integers(model.nv))
    inertia = 1.0 / float(model.dof_invweight0[j])
    out = {"world": world, "joint": model.joint(j).name, "late": 0, "size": 0.0}
    if world == "friction":
        out["size"] = float(rng.uniform(0.2, 0.5) * usual[j])
        model.dof_frictionloss[j] += out["size"]
    elif world == "rotor":
        out["size"] = float(rng.uniform(1.0, 2.0) * inertia)
        model.dof_armature[j] += out["size"]
    elif world == "delay":
        out["late"] = int(rng.integers(2, 5))
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return out


def recorded(folder: Path, path: Path, world: str, rng: np.random.Generator) -> dict:
    """The folder of a world; what is hidden in it."""
    folder.mkdir(parents=True, exist_ok=True)
    spec = hung(path)
    model = spec.compile()
    (folder / "robot.xml").write_text(spec.to_xml())
    (folder / "meta.toml").write_text('task = "mechanism"\nmodel = "robot.xml"\ninput = "torque"\n')
    low, high = np.where(model.jnt_limited[:, None] > 0, model.jnt_range, [-1.0, 1.0]).T
    home = np.clip(0.5 * (low + high), low + 0.4, np.maximum(high - 0.4, low + 0.4))
    nominal = spec.compile()
    truth = with_hidden(model, world, usual_torque(nominal, home, rng), rng)
    names = [model.joint(k).name for k in range(model.njnt)]
    header = ",".join(["time", *(f"q_{n}" for n in names), *(f"tau_{n}" for n in names)])
    inertia = 1.0 / nominal.dof_invweight0
    for trial in range(TRIALS):
        speed, phase = rng.uniform(0.2, FASTEST, (3, model.nv)), rng.uniform(0, 6.3, (3, model.nv))

        def target(t, speed=speed, phase=phase):
            return home + SWING / 3.0 * np.sin(2 * np.pi * speed * t + phase).sum(0)

        data, ideal, rows, sent = mujoco.MjData(model), mujoco.MjData(nominal), [], []
        data.qpos[:] = target(0.0)
        for k in range(round((SECONDS + 1.0) / ROW)):
            ideal.qpos[:] = data.qpos
            mujoco.mj_forward(nominal, ideal)
            late = target(k * ROW) - data.qpos
            torque = ideal.qfrc_bias + inertia * FAST * (FAST * late - 2.0 * data.qvel)
            sent.append(torque)
            data.ctrl[:] = torque
            if truth["late"]:
                j = model.joint(truth["joint"]).id
                data.ctrl[j] = sent[max(0, k - truth["late"])][j]
            if k * ROW >= 1.0:
                angles = data.qpos + NOISE * rng.standard_normal(model.nv)
                rows.append([k * ROW - 1.0, *angles, *torque])
            mujoco.mj_step(model, data, round(ROW / FINE))
        file = folder / f"t{trial}.csv"
        np.savetxt(file, rows, fmt="%.8g", delimiter=",", header=header, comments="")
    return truth


def counted(report: dict, truth: dict) -> tuple[int, list[str]]:
    """How many of the names are what is hidden, and the others."""
    wanted, right, wrong = NAMES[truth["world"]], 0, []
    for row in report["effects"]:
        rivals = [a.partition("@")[::2] for a in row["alternatives"]]
        every = [(row["name"], row["where"]), *((n, w or row["where"]) for n, w in rivals)]
        if (wanted, truth["joint"]) in every:
            right += 1
        else:
            wrong.append(f"{row['name']} at {row['where']}")
    return right, wrong


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("robots", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--worlds", nargs="+", type=int, default=range(14))
    given = parser.parse_args()
    from adaptsim_jax.attribution.diagnose import diagnose

    kinds, total = [*WORLDS, "friction", *["null"] * 4], [0, 0]
    for k in given.worlds:
        robot, rng = ROBOTS[k % 3], np.random.default_rng([given.seed, k])
        folder = given.out / f"{k}_{kinds[k]}"
        truth = recorded(folder, given.robots / f"{robot}.xml", kinds[k], rng)
        began = time.monotonic()
        report = diagnose(folder, out=folder / "out")
        right, wrong = counted(report, truth)
        total[0], total[1] = total[0] + right, total[1] + len(wrong)
        row = {"robot": robot, **truth, "right": right, "wrong": wrong}
        row |= {"verdict": report["verdict"], "judge": report["yardsticks"]["judge"]}
        print(json.dumps(row | {"seconds": round(time.monotonic() - began)}), flush=True)
    print(json.dumps({"right": total[0], "wrong": total[1]}))


if __name__ == "__main__":
    main()
