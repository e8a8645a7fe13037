"""Arms with position servos whose file is wrong in four ways at once: is a file recommended that is
worse at a joint than the declared one?

    python experiments/files_recommended.py ROBOTS OUT --arms ufactory_lite6__lite6

ROBOTS: a folder of MJCF files. Hidden: kp of 0.7 and kv of 0.4 of the file's, 3 N m of dry friction
at the third joint, 0.5 kg at the hand. Four logs of 10 s at 50 Hz, angles and targets in steps of
1 mrad, at rest half of the time. A line of JSON an arm: names, headline, what to do, and for each
file which joints it makes worse over stretches and over whole trials.
"""

import argparse
import json
import time
from pathlib import Path

import mujoco
import numpy as np

ARMS = ("ufactory_lite6__lite6", "ufactory_xarm7__xarm7_nohand", "kuka_iiwa_14__iiwa14")
STEP, ROW, SECONDS, TRIALS = 1e-3, 0.02, 10.0, 4  # rad, s, s


def own(path: Path) -> mujoco.MjModel:
    """The machine: the file with what is hidden, stepped at 1 ms without contact."""
    spec = mujoco.MjSpec.from_file(str(path))
    for key in list(spec.keys):
        spec.delete(key)
    model = spec.compile()
    model.opt.timestep = 1e-3
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    model.actuator_gainprm[:, 0] *= 0.7
    model.actuator_biasprm[:, 1] *= 0.7
    model.actuator_biasprm[:, 2] *= 0.4
    model.dof_frictionloss[2] += 3.0
    model.body_mass[-1] += 0.5
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def targets(rng: np.random.Generator, home: np.ndarray, low, high) -> np.ndarray:
    """[T, n]: smooth moves of half a second to a second, each followed by as long a rest."""
    now, rows = home.copy(), []
    while len(rows) < SECONDS / ROW:
        end = np.clip(home + rng.uniform(-0.4, 0.4, len(home)), low, high)
        count = int(rng.uniform(0.5, 1.0) / ROW)
        s = np.arange(1, count + 1) / count
        way = 10 * s**3 - 15 * s**4 + 6 * s**5
        rows += [*(now + w * (end - now) for w in way), *[end] * count]
        now = end
    return np.round(np.array(rows[: int(SECONDS / ROW)]) / STEP) * STEP


def written(folder: Path, path: Path, seed: int) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "arm.xml").write_text(path.read_text())
    (folder / "meta.toml").write_text('task = "mechanism"\nmodel = "arm.xml"\n')
    model, rng = own(path), np.random.default_rng(seed)
    low, high = model.jnt_range.T + np.array([[0.1], [-0.1]])
    home = np.clip(0.0 * low, low + 0.4, high - 0.4)
    joints = [model.joint(j).name for j in range(model.njnt)]
    header = ",".join(["time", *(f"q_{j}" for j in joints), *(f"ctrl_{j}" for j in joints)])
    for trial in range(TRIALS):
        data, rows = mujoco.MjData(model), []
        data.qpos[:] = data.ctrl[:] = home
        mujoco.mj_step(model, data, 1000)
        for k, target in enumerate(targets(rng, home, low, high)):
            rows.append([k * ROW, *np.round(data.qpos / STEP) * STEP, *target])
            data.ctrl[:] = target
            mujoco.mj_step(model, data, round(ROW / model.opt.timestep))
        name = folder / f"t{trial}.csv"
        np.savetxt(name, rows, fmt="%.6g", delimiter=",", header=header, comments="")
    return folder


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("robots", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--arms", nargs="+", default=ARMS)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    from adaptsim_jax.attribution.diagnose import diagnose
    from adaptsim_jax.report import diagnosis_words as words

    for arm in given.arms:
        data = written(given.out / arm / "log", given.robots / f"{arm}.xml", given.seed)
        began = time.time()
        report = diagnose(data, out=given.out / arm / "report")
        row = {
            "arm": arm,
            "names": [f"{e['name']} at {e['where']}" for e in report["effects"]],
            "headline": words.headline(report),
            "todo": words.todo(report),
            "files": report.get("files"),
            "seconds": round(time.time() - began),
        }
        print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
