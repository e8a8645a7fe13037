"""`adaptsim parity`."""

from __future__ import annotations

import argparse

EXAMPLES = """
  adaptsim parity pendulum
  adaptsim parity pendulum --samples 200 --json
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    from adaptsim_jax.commands.common import positive

    parser.add_argument("task", metavar="TASK", help="pendulum, pushing or scooping")
    parser.add_argument(
        "--samples", type=positive, default=64, metavar="N", help="random samples (default 64)"
    )
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(args: argparse.Namespace) -> int:
    """Final-state differences of the backends over random parameters and starts."""
    from adaptsim_jax.commands.common import check_task, require

    check_task(args.task)
    require("adaptsim_jax.models.backends.parity", "'adaptsim parity'")
    return 0
