"""Own worlds of a real arm's kind (`tests/generators/arm_worlds.py`): which effects the torque
witness names, right and wrong.

    python experiments/arm_worlds.py ../shared/data/robots OUT --first 100 --count 20 --kinds null
    python experiments/arm_worlds.py ../shared/data/robots OUT --first 200 --count 30 --kinds \\
        friction rotor gain offset spring

A kind may end in `+payload`: `friction+payload`. Its mass counts as right within 25 %, at the last
body or the one before it. A line a world; `--whole` runs all of `adaptsim diagnose` instead of the
witness alone.
"""

import argparse
import time
from pathlib import Path

import numpy as np

from adaptsim_jax.attribution.diagnose import diagnose
from adaptsim_jax.attribution.equation.models import search_balances
from adaptsim_jax.attribution.load import load
from adaptsim_jax.attribution.parameters import BODY_MASS, INERTIA
from adaptsim_jax.attribution.posed import declared_vector
from adaptsim_jax.attribution.problem import own_inertia, scaled_reach
from adaptsim_jax.core import process
from adaptsim_jax.diagnosis.criteria import Criteria
from experiments.torque_witness import prepared
from tests.generators.arm_worlds import KINDS, PAYLOAD, write_arm

ROBOTS = (
    "unitree_z1__z1",
    "ufactory_lite6__lite6",
    "ufactory_xarm7__xarm7_nohand",
    "kuka_iiwa_14__iiwa14",
    "kinova_gen3__gen3",
)


CHOICES = (*KINDS, *(f"{kind}+{PAYLOAD}" for kind in KINDS))


def named_by_witness(folder: Path) -> tuple[set[tuple[str, int]], float, dict[int, float]]:
    """(effect, joint) named, the farthest inertial coordinate, and masses by joint, kg."""
    machine = load(folder, None)
    problem, told = prepared(machine)
    null = declared_vector(machine, problem)
    found = search_balances(
        problem, told, null, scaled_reach(problem, *own_inertia(problem, null)), Criteria(), False
    )
    eta = [
        abs(z)
        for e, z in zip(found.final.entries, found.final.values, strict=True)
        if e.owner == INERTIA
    ]
    names = {(n.candidate.effect, j) for n in found.named for j in n.candidate.joints}
    masses = {j: found.final.known()[BODY_MASS, "mass", (j,)] for e, j in names if e == BODY_MASS}
    return names, max(eta), masses


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("robots", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--first", type=int, default=100)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--kinds", nargs="+", default=["friction"], choices=CHOICES)
    parser.add_argument("--whole", action="store_true")
    args = parser.parse_args()
    process.small_steps()
    total = {"right": 0, "wrong": 0, "missed": 0, "hidden": 0}
    for k, seed in enumerate(range(args.first, args.first + args.count)):
        robot, kind, folder = (
            ROBOTS[seed % len(ROBOTS)],
            args.kinds[k % len(args.kinds)],
            args.out / f"{seed}",
        )
        world = write_arm(folder, args.robots / f"{robot}.xml", kind, seed)
        truth = {tuple(e) for e in world["effects"]}
        began = time.process_time()
        if args.whole:
            rows = diagnose(folder)["effects"]
            index = {n: j for j, n in enumerate(load(folder, None).tree.joint_names)}
            names, far = {(row["name"], index[j]) for row in rows for j in row["joints"]}, np.nan
            masses = {
                index[row["joints"][0]]: row["parameters"]["mass"]["value"]
                for row in rows
                if row["name"] == BODY_MASS
            }
        else:
            names, far, masses = named_by_witness(folder)
        payload, last = world.get(PAYLOAD), len(world["coulomb"]) - 1
        if payload is not None:
            near = {j for j in masses if j >= last - 1}
            truth |= {(BODY_MASS, j) for j in near if abs(masses[j] / payload - 1.0) < 0.25}
            truth |= set() if near else {(BODY_MASS, last)}
        for key, some in (
            ("right", names & truth),
            ("wrong", names - truth),
            ("missed", truth - names),
            ("hidden", truth),
        ):
            total[key] += len(some)
        print(
            f"{seed} {robot} {kind}: right {len(names & truth)} of {len(truth)}, wrong "
            f"{sorted(names - truth)}, missed {sorted(truth - names)}, masses {masses} of "
            f"{payload}, inertia {far:.2f}, "
            f"{time.process_time() - began:.0f} s",
            flush=True,
        )
    print(total)


if __name__ == "__main__":
    main()
