"""Robots that people have: a log of each one's own actuators, made by MuJoCo at the file's own
step, and how well it is replayed.

    python experiments/robot_replays.py ROBOTS OUT

ROBOTS: a folder of MJCF files. Each log: 2 trials of 2 s, a row a step, free bases welded at `home`
(a body with nothing but its free joint flies, and its pose is logged), contact as the file has it,
twelve digits, no noise. A line a file: the simulator chosen and why, the median and largest error
over stretches of 0.5 s, seconds; then how many are within 1e-6.
"""

import argparse
import time
from pathlib import Path

import mujoco
import numpy as np

from experiments.robot_worlds import commands, welded

POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")


def record(path: Path, folder: Path) -> None:
    """Two trials of a file into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "meta.toml").write_text(f'task = "mechanism"\nmodel = "{path.resolve()}"\n')
    own = mujoco.MjModel.from_xml_path(str(path))
    flies = own.njnt == 1 and own.jnt_type[0] == 0
    model, pose = (own, own.key_qpos[0] if own.nkey else own.qpos0) if flies else welded(path)
    data, h = mujoco.MjData(model), float(own.opt.timestep)
    joints = [k for k in range(model.njnt) if model.jnt_type[k] >= 2]
    names = [f"q_{model.joint(k).name or f'joint{k + 1}'}" for k in joints] + (
        [f"base_{c}" for c in POSE] if flies else []
    )
    names += [f"ctrl_{model.actuator(k).name or f'actuator{k + 1}'}" for k in range(model.nu)]
    rng = np.random.default_rng(0)
    for trial in range(2):
        mujoco.mj_resetData(model, data)
        data.qpos[:] = pose
        mujoco.mj_forward(model, data)
        told = commands(model, data, rng)
        rows = []
        for row in range(int(2.0 / h)):
            data.ctrl[:] = told(row * h)
            angles = [data.qpos[model.jnt_qposadr[k]] for k in joints]
            rows.append([row * h, *angles, *(data.qpos[:7] if flies else []), *data.ctrl])
            mujoco.mj_step(model, data)
        np.savetxt(
            folder / f"run_{trial}.csv",
            rows,
            delimiter=",",
            header=",".join(["time", *names]),
            comments="",
            fmt="%.12g",
        )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    args = parser.parse_args()
    from adaptsim_jax.attribution.choice import choose
    from adaptsim_jax.core.errors import BadInput
    from adaptsim_jax.simulators.mujoco.replay import replayed

    within = total = 0
    for path in sorted(args.folder.glob("*.xml")):
        data, began, total = args.out / path.stem, time.monotonic(), total + 1
        try:
            if not data.exists():
                record(path, data)
            choice = choose(data, None, None, 0.5)
            found = replayed(choice.source, choice.log, 0.5)
            error = (
                found.error if found.base is None else np.concatenate([found.error, found.base], 1)
            )
            within += choice.simulator == "mujoco" and float(np.median(error)) < 1e-6
            line = (
                f"{choice.simulator} ({choice.why}) median {np.median(error):.1e} largest "
                f"{np.max(error):.1e}"
            )
        except BadInput as error:
            line = f"refused: {error}"
        print(f"{path.stem}: {line}, {time.monotonic() - began:.1f} s", flush=True)
    print(f"{within} of {total} within 1e-6")


if __name__ == "__main__":
    main()
