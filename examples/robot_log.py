"""A short synthetic log of a robot, made by MuJoCo, to try a meta.toml on before there is a real
one.

    python examples/robot_log.py so101.xml examples/so101 --degrees --friction elbow_flex=0.3
    python examples/robot_log.py go2.xml examples/go2_hung
    python examples/robot_log.py panda.xml examples/panda_hand --friction joint4=3

Four trials of 4 s at 100 Hz into FOLDER/log, and a copy of MODEL beside them; a free base hangs (it
is welded). `--friction` adds dry friction (N m) to a joint that the model file does not know of:
what `adaptsim diagnose FOLDER --out out` should name.
"""

import argparse
import shutil
from pathlib import Path

import mujoco
import numpy as np

RATE, SECONDS, TRIALS = 100, 4.0, 4


def hung(path: Path) -> mujoco.MjModel:
    """The model without its free base and its keys."""
    spec = mujoco.MjSpec.from_file(str(path))
    for joint in [j for j in spec.joints if j.type == mujoco.mjtJoint.mjJNT_FREE]:
        for sensor in [s for s in spec.sensors if s.objname == joint.name]:
            spec.delete(sensor)
        spec.delete(joint)
    for key in list(spec.keys):
        spec.delete(key)
    return spec.compile()


def record(model: mujoco.MjModel, seed: int) -> np.ndarray:
    """Rows [T, 1 + njnt + nu] of time, angles and commands: sums of sines in the middle of what the
    actuators take.
    """
    rng, data = np.random.default_rng(seed), mujoco.MjData(model)
    low, high = np.where(
        model.actuator_ctrllimited[:, None], model.actuator_ctrlrange, [-0.5, 0.5]
    ).T
    share = np.where(model.actuator_biasprm[:, 1] < 0, 0.2, 0.1)  # of the range: servos, motors
    speed, phase = rng.uniform(0.2, 1.2, (3, model.nu)), rng.uniform(0, 2 * np.pi, (3, model.nu))
    rows, steps = [], round(1 / RATE / model.opt.timestep)
    for row in range(int(RATE * SECONDS)):
        swing = np.sin(2 * np.pi * speed * row / RATE + phase).mean(0)
        data.ctrl[:] = (low + high) / 2 + share * (high - low) * swing
        rows.append([row / RATE, *data.qpos, *data.ctrl])
        for _ in range(max(1, steps)):
            mujoco.mj_step(model, data)
    out = np.array(rows)
    out[:, 1 : 1 + model.njnt] += 1e-4 * rng.standard_normal((len(out), model.njnt))
    return out


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("model", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--friction", nargs="*", default=[], metavar="JOINT=N_M")
    parser.add_argument(
        "--degrees",
        action="store_true",
        help="write angles, and targets of servos, in degrees, as LeRobot does",
    )
    args = parser.parse_args(arguments)
    model = hung(args.model)
    for name, size in (item.split("=") for item in args.friction):
        model.dof_frictionloss[model.joint(name).dofadr] += float(size)
    servo = {
        int(model.actuator_trnid[k, 0]): k
        for k in range(model.nu)
        if model.actuator_trntype[k] == 0 and model.actuator_biasprm[k, 1] < 0
    }
    target = {k: f"target_{model.joint(j).name}" for j, k in servo.items()}
    names = ["time", *(f"q_{model.joint(k).name}" for k in range(model.njnt))]
    names += [target.get(k, f"ctrl_{model.actuator(k).name}") for k in range(model.nu)]
    angles = (
        [i for i, n in enumerate(names) if n.startswith(("q_", "target_"))] if args.degrees else []
    )
    log = args.folder / "log"
    log.mkdir(parents=True, exist_ok=True)
    shutil.copy(args.model, args.folder / "robot.xml")
    for trial in range(TRIALS):
        rows = record(model, trial)
        rows[:, angles] = np.rad2deg(rows[:, angles])
        np.savetxt(
            log / f"run_{trial}.csv",
            rows,
            delimiter=",",
            header=",".join(names),
            comments="",
            fmt="%.7g",
        )


if __name__ == "__main__":
    main()
