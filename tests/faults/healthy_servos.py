"""Healthy logs of servos, in the forms that people have them: what is said of their commands,
scales and clocks is a false alarm.

python -m tests.faults.healthy_servos FOLDER 8100 100       seed, sets of each reader (CSV, npz,
LeRobot, bags, MCAP)
"""

import sys
from pathlib import Path

import numpy as np

from adaptsim_jax.attribution.conventions import check_conventions
from adaptsim_jax.attribution.load import load
from adaptsim_jax.core.errors import BadInput
from tests.faults.servo_files import log, model, noisy, sines, steps, swung
from tests.logs.log_files import HEAD

NAMES = ("left", "right")
WORDS = (
    "jitter",
    "per cent",
    "turns",
    "parts of a sample",
    "look",
    "left out",
    "far from",
    "not what acted",
    "another order",
    "differs",
    "clock",
    "time runs",
    "rows are missing",
    "in the order",
    "times d(",
    "end at exactly",
    "reach",
)


def trials(seed: int):
    """Four trials: sines, steps or slow targets, at 30 to 500 Hz, of servos whose force has a limit
    in one set of four.
    """
    rng = np.random.default_rng(seed)
    rate = float(rng.choice([30.0, 50.0, 100.0, 250.0, 500.0]))
    rows, kind = int(2.5 * rate), int(rng.integers(3))
    out = []
    for k in range(4):
        if kind == 0:
            u = sines(10 * seed + k, rows, rate, 2, float(rng.uniform(0.2, 1.2)))
        elif kind == 1:
            u = np.concatenate(
                [
                    steps(10 * seed + k + j, rows, int(0.5 * rate), float(rng.uniform(0.2, 0.8)))
                    for j in range(2)
                ],
                1,
            )
        else:
            u = np.cumsum(rng.normal(size=(rows, 2)) * 0.3 / np.sqrt(rate), 0)
        gain = 1.0 + 0.02 * rng.normal()
        out.append((np.arange(rows) / rate, noisy(swung(u, rate, gain), seed + k), u))
    return out


def written(folder: Path, how: str, seed: int) -> Path:
    some = trials(seed)
    if how == "csv":
        return log(folder, "", NAMES, some)
    folder.mkdir(parents=True)
    (folder / "robot.xml").write_text(model(NAMES))
    (folder / "meta.toml").write_text(
        f'{HEAD}model = "robot.xml"\ndata = "data"\n'
        + ('[units]\nangle = "deg"\n' if how == "lerobot" else "")
    )
    if how == "npz":
        (folder / "data").mkdir()
        for k, (t, q, u) in enumerate(some):
            np.savez(folder / "data" / f"run_{k}.npz", time=t, q=q, target=u)
        return folder
    if how == "lerobot":
        from tests.faults.test_scales_and_names import data_set

        t, q, u = some[0]
        data_set(folder / "data", np.degrees(q), np.degrees(u), [f"{n}.pos" for n in NAMES])
        return folder
    from tests.logs.test_bags import Bag, ns

    (folder / "data").mkdir()
    for k, (t, q, u) in enumerate(some[:3]):
        bag = Bag(how)
        for i, x in enumerate(t):
            bag.joints("/joint_states", ns(x), NAMES, q[i])
            bag.joints("/commands", ns(x + 1e-4), NAMES, u[i])
        at = folder / "data" / f"run_{k}"
        at.mkdir()
        made = bag.write(at)
        made.rename(folder / "data" / f"run_{k}_{made.name}")
        if not any(at.iterdir()):
            at.rmdir()
    return folder


def said(source: Path) -> list[str]:
    try:
        machine = load(source)
        told = [f.message for f in check_conventions(machine)]
    except BadInput as error:
        return [f"refused: {error}"]
    return told + [note for note in machine.log.notes if any(word in note for word in WORDS)]


if __name__ == "__main__":
    np.seterr(all="ignore")
    at, first, count = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    alarms = 0
    for how in ("csv", "npz", "lerobot", "bag", "ros2", "mcap"):
        lines = [
            f"{how} {seed}: {line}"
            for seed in range(first, first + count)
            for line in said(written(at / f"{how}_{seed}", how, seed))
        ]
        alarms += len(lines)
        print(f"{how}: {count} sets, {len(lines)} lines said", *lines, sep="\n  ", flush=True)
    sys.exit(bool(alarms))
