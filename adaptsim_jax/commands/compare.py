"""`adaptsim compare`."""

from __future__ import annotations

import argparse

EXAMPLES = """
  adaptsim compare pendulum --out results
  adaptsim compare pendulum --out quick --seeds 2 --settings wd,ood-1 --methods adaptsim,sysid-point
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    from adaptsim_jax.commands.common import positive

    parser.add_argument("task", metavar="TASK", help="pendulum, pushing or scooping")
    parser.add_argument("--out", required=True, metavar="DIR", help="folder for results.json, table and figure")
    parser.add_argument("--seeds", type=positive, default=20, metavar="N", help="seeds of each method (default 20)")
    parser.add_argument("--methods", metavar="A,B", help="default: all")
    parser.add_argument("--settings", metavar="A,B", help="default: wd and ood-1 .. ood-4")


def run(args: argparse.Namespace) -> int:
    """Table 1 of the paper for one task."""
    from adaptsim_jax.commands.common import check_task, require

    check_task(args.task)
    require("adaptsim_jax.baselines.compare", "'adaptsim compare'")
    return 0
