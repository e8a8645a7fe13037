"""`adaptsim demo`."""

from __future__ import annotations

import argparse

EXAMPLES = """
  adaptsim demo
  adaptsim demo --out demo_out --seed 1
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--out", default="demo_out", metavar="DIR", help="default: demo_out")


def run(args: argparse.Namespace) -> int:
    """The tour on small sizes."""
    from adaptsim_jax.commands.common import require

    require("adaptsim_jax.demo", "'adaptsim demo'")
    return 0
