"""Six arms as a new user would log them: servos that are not the file's, friction at one joint, a
mass in the gripper.

    python -m experiments.newcomer_arms ROBOTS OUT --seed 1 --arms lite6 ur5e

ROBOTS: a folder of MJCF files. Four trials of 12 s and one more in `val`: targets at 50 Hz, angles
in steps of 1 mrad, at rest half of the time. kp is 0.7 and kv 0.4 of the file's, dry friction is
added at the third joint, a mass 8 cm outward of the last body's centre. MuJoCo steps the truth
every 0.2 ms. A line of JSON an arm: what was named, what of it is wrong or missing, and what
`declared.xml`, `model.xml` and no model at all leave of the whole trial in `val`, by joint.
"""

import argparse
import json
import shutil
import time
from pathlib import Path

import numpy as np

from adaptsim_jax.attribution.diagnose import diagnose
from adaptsim_jax.logs.read import read_source_and_log
from adaptsim_jax.mechanisms.spec import read_source
from adaptsim_jax.simulators.closed_loop.imposed import Recording, heavier
from adaptsim_jax.simulators.closed_loop.law import put_law
from adaptsim_jax.simulators.closed_loop.recording import recording_of
from adaptsim_jax.simulators.closed_loop.whole import simulate, trial_errors
from experiments.servo_law_worlds import (
    ARMS,
    FINE,
    IMPLICIT,
    World,
    judged,
    machine,
    recorded,
    targets,
)

ADDED = {
    "lite6": (3.0, 0.5),
    "xarm7": (4.0, 0.6),
    "panda": (5.0, 0.8),
    "ur5e": (8.0, 1.5),
    "fr3": (5.0, 0.8),
    "so101": (0.2, 0.1),
}
"""Dry friction that the third joint has beside the file's, N m, and the mass, kg."""
GAINS = {"kp": 0.7, "kv": 0.4}
TOOL = 0.08  # m, from the last body's centre of mass outward
RATE, SECONDS, TRIALS = 50, 12.0, 5


def written(folder: Path, path: Path, arm: str, seed: int) -> dict:
    """The folder of an arm, its last trial in `val`; the truth."""
    model, pose, servos = machine(path)
    rng, (friction, mass) = np.random.default_rng(seed), ADDED[arm]
    hand = int(model.jnt_bodyid[model.dof_jntid[servos[-1].dof]])
    laws = []
    for j, s in enumerate(servos):
        damping = (s.law.damping - s.passive) * GAINS["kv"] + s.passive
        own = s.law._replace(kp=s.law.kp * GAINS["kp"], damping=damping, payload=mass)
        laws.append(own._replace(rub=own.rub + friction) if j == 2 else own)
    way = model.body_ipos[hand] - model.jnt_pos[model.body_jntadr[hand]]
    way = way if np.linalg.norm(way) > 0.01 else model.jnt_axis[model.body_jntadr[hand]]
    real = heavier(model, hand, mass, model.body_ipos[hand] + TOOL * way / np.linalg.norm(way))
    for s, law in zip(servos, laws, strict=True):
        put_law(s, real, law)
    real.opt.timestep, real.opt.integrator = FINE, IMPLICIT
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "val").mkdir(parents=True)
    for where in (folder, folder / "val"):
        (where / "meta.toml").write_text(f'task = "mechanism"\nmodel = "{path.name}"\n')
        shutil.copy(path, where / path.name)
    ends = np.array([model.jnt_range[model.dof_jntid[s.dof]] for s in servos])
    reach = np.array([s.command_range for s in servos])
    low, high = np.maximum(ends[:, 0], reach[:, 0]) + 0.1, np.minimum(ends[:, 1], reach[:, 1]) - 0.1
    home = np.clip(pose[[s.qpos for s in servos]], low + 0.1, high - 0.1)
    span = np.minimum(rng.uniform(0.5, 1.0, len(home)), 0.5 * (high - low))
    names = [s.name for s in servos]
    heads = ",".join(["time", *(f"q_{n}" for n in names), *(f"target_{n}" for n in names)])
    for k in range(TRIALS):
        moves = targets(rng, home, low, high, span, SECONDS, "holds")
        how = (pose, RATE, SECONDS, 0.0, model)
        rows = recorded(real, servos, laws, moves, how, (1e-3, 1e-4, rng))
        where = folder / "val" if k == TRIALS - 1 else folder
        np.savetxt(where / f"run_{k}.csv", rows, "%.7f", ",", header=heads, comments="")
    file = [s.law._asdict() for s in servos]
    return {"laws": [law._asdict() for law in laws], "names": names, "file": file}


def recorded_in(model: Path, data: Path) -> Recording:
    """The whole trials of a folder as a model file simulates them."""
    made = recording_of(read_source(model), read_source_and_log(data, None)[1])
    assert made is not None
    return made


def left_of(recording: Recording) -> np.ndarray:
    """RMS errors [n] rad of whole trials."""
    (path,) = simulate(recording, [[s.law for s in recording.servos]])
    return np.sqrt(np.square(trial_errors(recording, path)).mean(0))


def without_a_model(recording: Recording) -> dict[str, np.ndarray]:
    """RMS errors [n] rad of a straight line through each whole trial, and of holding still."""
    line, still = [], []
    for t in recording.trials:
        fit = np.polynomial.polynomial.polyfit(t.time, t.q, 1)
        line.append(t.q - np.polynomial.polynomial.polyval(t.time, fit).T)
        still.append(t.q - t.q.mean(0))
    both = {"straight line": line, "holding still": still}
    return {k: np.sqrt(np.square(np.concatenate(z)).mean(0)) for k, z in both.items()}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("robots", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--arms", nargs="*", default=list(ADDED), choices=list(ADDED))
    args = parser.parse_args()
    for arm in args.arms:
        folder, out = args.out / arm, args.out / f"{arm}_out"
        true = written(folder, args.robots / f"{ARMS[arm]}.xml", arm, args.seed)
        began = time.monotonic()
        report = diagnose(folder, out=out)
        seconds = round(time.monotonic() - began)
        rows = {(e["name"], e["where"]): e["parameters"] for e in report["effects"]}
        found = judged(report, true, World(arm, RATE, "holds", GAINS))
        val = [recorded_in(out / f"{name}.xml", folder / "val") for name in ("declared", "model")]
        left = without_a_model(val[0]) | {"file": left_of(val[0]), "model": left_of(val[1])}
        numbers = {
            f"{name} at {where}": {k: [v["low"], v["value"], v["high"]] for k, v in row.items()}
            for (name, where), row in rows.items()
            if name != "position_gain"
        }
        mrad = {k: [round(1e3 * float(z), 3) for z in e] for k, e in left.items()}
        line = {"arm": arm, **found, "numbers": numbers, "val_mrad": mrad, "seconds": seconds}
        print(json.dumps(line, default=float), flush=True)


if __name__ == "__main__":
    main()
