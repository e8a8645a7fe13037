"""`adaptsim parity`."""

from __future__ import annotations

import argparse
import json
from typing import Any

EXAMPLES = """
  adaptsim parity pendulum
  adaptsim parity pendulum --samples 200 --json
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    from adaptsim_jax.commands.common import positive

    parser.add_argument("task", metavar="TASK", help="pendulum, pushing or scooping")
    parser.add_argument("--samples", type=positive, default=32, metavar="N", help="random samples (32)")
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(args: argparse.Namespace) -> int:
    """Final-state differences of the backends over random parameters, commands and starts."""
    from adaptsim_jax.commands.common import check_task
    from adaptsim_jax.progress import progress

    check_task(args.task)
    from adaptsim_jax.models.backends.parity import parity

    with progress(f"parity {args.task}") as report:
        found = parity(args.task, samples=args.samples, seed=args.seed, progress=report)
    if args.json:
        print(json.dumps(found, indent=1))
    else:
        _show(found)
    return 0


def _show(found: dict[str, Any]) -> None:
    print(
        f"{found['task']}: {found['samples']} random samples of {found['seconds']:g} s, double precision;\n"
        f"differences of the final state from {found['reference']} MuJoCo, median and largest\n"
    )
    print(f"{'backend':12} {'angle [rad]':>19} {'velocity [rad/s]':>19} {'diverged':>9}")
    for row in found["rows"]:
        if not row["ran"]:
            print(f"{row['backend']:12} did not run: {row['why']}")
        elif "angle_median" not in row:
            print(f"{row['backend']:12} all {row['diverged']} samples diverged")
        else:
            pairs = [f"{row[f'{k}_median']:9.1e} {row[f'{k}_max']:9.1e}" for k in ("angle", "velocity")]
            print(f"{row['backend']:12} {pairs[0]} {pairs[1]} {row['diverged']:9}")
