"""`adaptsim doctor`."""

from __future__ import annotations

import argparse
import json

EXAMPLES = """
  adaptsim doctor
  adaptsim doctor --json > doctor.json     for a report of a fault
  adaptsim doctor --costs                  and what a trajectory of Phase 1 costs here in each engine; some minutes
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument(
        "--costs", action="store_true", help="measure what a trajectory costs in each engine, too"
    )


def run(args: argparse.Namespace) -> int:
    """0 where everything that the core needs works here, else 1."""
    from adaptsim_jax.commands import doctor_checks as doctor
    from adaptsim_jax.commands.common import next_step
    from adaptsim_jax.commands.doctor_costs import costs, line

    found = doctor.examine()
    rows = costs() if args.costs else iter(())
    if args.json:
        print(json.dumps(found | ({"costs": list(rows)} if args.costs else {}), indent=1))
        if found["faults"]:
            return 1
        return 0
    doctor.show(found)
    for row in rows:
        print(line(row), flush=True)
    if not found["faults"]:
        next_step("demo    the tour, a few minutes")
    if found["faults"]:
        return 1
    return 0
