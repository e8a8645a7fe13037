"""`adaptsim adapt`."""

from __future__ import annotations

import argparse

EXAMPLES = """
  adaptsim adapt runs/a --target ood-1
  adaptsim adapt runs/a --target my_robot.toml     m1 = 1.4, m2 = 0.6, ... one line each
  adaptsim adapt runs/a --target wd --starts 4 --iterations 20
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    from adaptsim_jax.commands.common import positive

    parser.add_argument("folder", metavar="RUN", help="a run folder of `adaptsim train`")
    parser.add_argument("--target", required=True, metavar="T", help="wd, ood-1 .. ood-4, or a TOML file")
    parser.add_argument(
        "--starts", type=positive, default=2, metavar="N", help="initial distributions (default 2)"
    )
    parser.add_argument(
        "--iterations", type=positive, default=10, metavar="I", help="adaptation steps (default 10)"
    )
    parser.add_argument("--out", metavar="DIR", help="default: RUN/adapt-TARGET")


def run(args: argparse.Namespace) -> int:
    """Phase 2 of a trained run."""
    from adaptsim_jax.commands.common import require

    require("adaptsim_jax.adapt.training", "'adaptsim adapt'")
    return 0
