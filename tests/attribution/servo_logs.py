"""Logs of arms with position servos, made by MuJoCo, beside a model file that may say something
else.
"""

from pathlib import Path

import mujoco
import numpy as np


def servo_log(
    folder: Path,
    file: str,
    own: str,
    seed: int,
    trials: int = 3,
    late: float = 0.0,
    noise: float = 1e-4,
) -> Path:
    """`folder` with `file` as the model, and trials of 4 s at 200 Hz of the machine `own` (both
    MJCF, a servo a joint, in the order of joints): sums of sines as commands, held from row to row,
    which arrive `late` s late; angles with noise (rad).
    """
    folder.mkdir()
    (folder / "model.xml").write_text(file)
    (folder / "meta.toml").write_text('task = "mechanism"\nmodel = "model.xml"\n')
    model, rng = mujoco.MjModel.from_xml_string(own), np.random.default_rng(seed)
    joints, steps = (
        [model.joint(j).name for j in range(model.njnt)],
        round(0.005 / model.opt.timestep),
    )
    n = len(joints)
    for trial in range(trials):
        data = mujoco.MjData(model)
        speed, phase = rng.uniform(0.3, 1.2, (3, n)), rng.uniform(0, 2 * np.pi, (3, n))

        def told(t, w=speed, p=phase):
            return 0.3 * np.sin(2 * np.pi * w * t + p).sum(0)

        data.qpos[:] = told(0.0)
        rows = []
        for k in range(800):
            rows.append([k / 200, *data.qpos + noise * rng.standard_normal(n), *told(k / 200)])
            for step in range(steps):
                data.ctrl[:] = told(np.floor(k + step / steps - 200 * late + 1e-9) / 200)
                mujoco.mj_step(model, data)
        names = ",".join(["time", *(f"q_{j}" for j in joints), *(f"ctrl_{j}" for j in joints)])
        np.savetxt(
            folder / f"run_{trial}.csv", rows, delimiter=",", header=names, comments="", fmt="%.9g"
        )
    return folder
