"""`adaptsim parity`."""

from __future__ import annotations

import argparse
import json

EXAMPLES = """
  adaptsim parity pendulum
  adaptsim parity pendulum --samples 200 --json
  adaptsim parity pushing --samples 200
  adaptsim parity scooping --samples 200
"""


def run(args: argparse.Namespace) -> int:
    """Final-state differences of the backends over random parameters, commands and starts."""
    from adaptsim_jax.commands.parser import check_task
    from adaptsim_jax.core.errors import BadInput
    from adaptsim_jax.core.progress import progress

    check_task(args.task)
    from adaptsim_jax.tasks.registry import TASKS

    parity = TASKS[args.task].parity
    if parity is None:
        able = [name for name, kind in TASKS.items() if kind.parity is not None]
        raise BadInput(f"task '{args.task}' has no engines to compare; use {', '.join(able)}")
    with progress(f"parity {args.task}") as report:
        found = parity.measured(args.samples, args.seed, report)
    if args.json:
        print(json.dumps(found, indent=1))
        return 0
    from adaptsim_jax.commands.parser import next_step

    print("\n".join(parity.lines(found)))
    next_step(f"train {args.task} --run runs/a")
    return 0
