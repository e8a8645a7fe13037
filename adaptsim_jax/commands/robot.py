"""`adaptsim robot`."""

from __future__ import annotations

import argparse

EXAMPLES = """
  adaptsim robot new runs/a --dir robot      start from a trained run
  adaptsim robot next --dir robot            which policy to run on the robot now
  adaptsim robot record trial.csv --dir robot
"""
STEPS = ("new", "next", "record")


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("step", metavar="new|next|record", help="start, ask, tell")
    parser.add_argument(
        "what", nargs="?", metavar="RUN|FILE", help="new: a trained run; record: measured data"
    )
    parser.add_argument("--dir", required=True, metavar="DIR", help="where the state is kept between calls")


def run(args: argparse.Namespace) -> int:
    """One step of ask/tell adaptation."""
    from adaptsim_jax.commands.common import require
    from adaptsim_jax.config import pick

    pick("step", args.step, STEPS)
    require("adaptsim_jax.adapt.robot", "'adaptsim robot'")
    return 0
