"""Six logs of one arm driven by torque, one with a payload and one with a late clock: which logs
are marked at which numbers, and whether pooled numbers' intervals hold the truth.

    python experiments/pooled_days.py ../shared/data/robots/ufactory_lite6__lite6.xml OUT \\
        --first 501 --count 4 --payload 0.5

A line a world: marks at the right log, at others, and how many intervals (90 %) hold the truth of
friction, damping and of what each joint carries. `--null`: no payload, no late clock.
"""

import argparse
import time
from pathlib import Path

import mujoco
import numpy as np

from adaptsim_jax.attribution.diagnose import diagnose
from adaptsim_jax.attribution.numbers import LATE
from adaptsim_jax.core import process
from tests.generators.arm_worlds import write_days

LOADED, LATE_DAY = "day3", "day5"


def truth_of(world: dict) -> dict[str, float]:
    """Friction, damping, and of each joint's load inertia and first moments at angles of zero."""
    model = world["model"]
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, full, data.qM) if hasattr(data, "qM") else mujoco.mj_fullM(
        model, data, full
    )
    out = {}
    for j in range(model.njnt):
        name, body = model.joint(j).name, int(model.jnt_bodyid[j])
        out[f"coulomb level at {name}"] = float(world["coulomb"][j])
        out[f"viscous damping at {name}"] = float(world["viscous"][j])
        out[f"inertia about {name}"] = float(full[j, j] - model.dof_armature[j])
        reach = data.subtree_com[body] - data.xanchor[j]
        moment = model.body_subtreemass[body] * reach
        axis, axes = data.xaxis[j], data.xmat[body].reshape(3, 3)
        for k, letter in enumerate("xyz"):
            across = axes[:, k] - (axes[:, k] @ axis) * axis
            out[f"first moment {letter} at {name}"] = float(across @ moment)
    return out


def is_mass(name: str) -> bool:
    """Whether a number is a body's."""
    return name.startswith(("first moment", "inertia", "mass", "centre of mass"))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("robot", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--first", type=int, default=501)
    parser.add_argument("--count", type=int, default=4)
    parser.add_argument("--payload", type=float, default=0.5)
    parser.add_argument("--rows", type=int, default=2, help="by which the late clock is late")
    parser.add_argument("--null", action="store_true")
    args = parser.parse_args()
    process.small_steps()
    right, wrong, held, asked = 0, 0, 0, 0
    for seed in range(args.first, args.first + args.count):
        began = time.monotonic()
        folder = args.out / f"{seed}"
        days = {"loaded": "", "late": ""} if args.null else {"loaded": LOADED, "late": LATE_DAY}
        world = write_days(folder, args.robot, seed, payload=args.payload, rows=args.rows, **days)
        report = diagnose(sorted(folder.glob("day*")))
        truth, rows = truth_of(world), report["numbers"]
        marks = {(day, row["name"]) for row in rows for day in row["apart"]}
        expected = {m for m in marks if m[0] == days["loaded"] and is_mass(m[1])}
        late = {m for m in marks if m[0] == days["late"] and m[1].startswith(LATE)}
        both = bool(expected) + bool(late)
        known = [row for row in rows if row["name"] in truth]
        out = [r["name"] for r in known if not r["low"] <= truth[r["name"]] <= r["high"]]
        right, wrong = right + both, wrong + len(marks - expected - late)
        held, asked = held + len(known) - len(out), asked + len(known)
        names = [(e["name"], e["where"]) for e in report["effects"] if e["name"] != "coulomb"]
        each = {e["of"]: e["value"] for r in rows if r["name"].startswith(LATE) for e in r["each"]}
        print(
            f"{seed}: marked {both} of {0 if args.null else 2} (payload at {len(expected)} numbers,"
            f" clock {1e3 * each.get(LATE_DAY, np.nan):.1f} ms of {10 * args.rows}), other marks "
            f"{sorted(marks - expected - late)}, of {len(known)} intervals without the truth {out},"
            f" named beside friction {names}, {time.monotonic() - began:.0f} s",
            flush=True,
        )
    print({"marked": right, "other marks": wrong, "held": held, "of": asked})


if __name__ == "__main__":
    main()
