"""Whether an effect is named from the size on that a report prints (`power`): logs of arms that
lack nothing, with one effect added to the torques at 0.3 to 3 times its printed size.

    python experiments/power_pairs.py ../shared/data/robots OUT --first 8300 --logs 8 --pairs 15

A line a pair, then the share that is named, by the factor. Arms, noise and friction are those of
`tests/generators/arm_worlds.py`; the torque along the motion judges alone.
"""

import argparse
from collections import defaultdict
from pathlib import Path

import numpy as np
from scipy.signal import savgol_filter

from adaptsim_jax.attribution.equation.models import TorqueSearch, search_balances
from adaptsim_jax.attribution.load import load
from adaptsim_jax.attribution.posed import declared_vector
from adaptsim_jax.attribution.problem import TreeProblem, own_inertia, scaled_reach
from adaptsim_jax.attribution.torque_report import power_rows
from adaptsim_jax.core import process
from adaptsim_jax.core.config import Table
from adaptsim_jax.diagnosis.criteria import Criteria
from experiments.arm_worlds import ROBOTS
from experiments.torque_witness import prepared
from tests.generators.arm_worlds import write_arm

EFFECTS = ("bias", "spring", "armature", "coulomb", "torque_gain")
FACTORS = (0.3, 0.4, 0.5, 0.8, 1.0, 1.2, 2.0, 2.5, 3.0)
BINS = {"below 0.5": (0.0, 0.45), "0.5": (0.45, 0.6), "at it": (0.6, 1.5), "from 2 on": (1.5, 9.0)}


def searched(folder: Path) -> tuple[TreeProblem, TorqueSearch]:
    """What the torque along the motion of a log names."""
    machine = load(folder, None)
    problem, balances = prepared(machine)
    null = declared_vector(machine, problem)
    reach = scaled_reach(problem, *own_inertia(problem, null))
    return problem, search_balances(problem, balances, null, reach, Criteria(), False)


def added(table: np.ndarray, n: int, effect: str, joint: int, size: float) -> np.ndarray:
    """A log's table [T, 1 + 2 n] with an effect at a joint, as its torque sensor would show it."""
    out, dt = table.copy(), float(np.median(np.diff(table[:, 0])))
    q = table[:, 1 + joint]
    v, a = (savgol_filter(q, 21, 3, deriv=k, delta=dt) for k in (1, 2))
    force = {
        "bias": np.ones_like(q),
        "spring": q,
        "armature": a,
        "coulomb": np.tanh(v / 1e-3),
        "torque_gain": -table[:, 1 + n + joint] / (1.0 + size),
    }[effect]
    out[:, 1 + n + joint] += size * force
    return out


def sizes(problem: TreeProblem, found: TorqueSearch) -> dict[tuple[str, int], float]:
    """Printed sizes by effect and joint."""
    rows: list[Table] = power_rows(problem, found)
    joints = list(problem.joint_names)
    return {
        (r["name"], joints.index(r["where"])): float(r["size"])
        for r in rows
        if r["name"] in EFFECTS and r["where"] in joints
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("robots", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--first", type=int, default=8300)
    parser.add_argument("--logs", type=int, default=8)
    parser.add_argument("--pairs", type=int, default=15)
    args = parser.parse_args()
    process.small_steps()
    named: dict[str, list[bool]] = defaultdict(list)
    for seed in range(args.first, args.first + args.logs):
        folder = args.out / f"{seed}"
        robot = args.robots / f"{ROBOTS[seed % len(ROBOTS)]}.xml"
        n = len(write_arm(folder, robot, "null", seed)["coulomb"])
        file = folder / "trial_0.csv"
        plain = np.loadtxt(file, delimiter=",", skiprows=1)
        head = file.read_text().splitlines()[0]
        printed = sizes(*searched(folder))
        rng = np.random.default_rng(seed)
        keys = sorted(printed)
        for k in rng.permutation(len(keys))[: args.pairs]:
            (effect, joint), factor = keys[k], float(rng.choice(FACTORS))
            size = factor * printed[effect, joint]
            table = added(plain, n, effect, joint, size)
            np.savetxt(file, table, delimiter=",", header=head, comments="", fmt="%.8g")
            _, found = searched(folder)
            names = {(c.candidate.effect, j) for c in found.named for j in c.candidate.joints}
            right = (effect, joint) in names
            for label, (low, high) in BINS.items():
                if low <= factor < high:
                    named[label].append(right)
            others = sorted(names - {(effect, joint)})
            print(
                f"{seed} {effect} {joint} {factor} of {printed[effect, joint]:.3g}: {right}, "
                f"beside it {others}",
                flush=True,
            )
    for label, some in named.items():
        print(f"{label}: {sum(some)} of {len(some)} named")


if __name__ == "__main__":
    main()
