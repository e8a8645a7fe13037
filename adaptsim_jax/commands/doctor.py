"""`adaptsim doctor`."""

from __future__ import annotations

import argparse
import json

EXAMPLES = """
  adaptsim doctor
  adaptsim doctor --json > doctor.json     for a report of a fault
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(args: argparse.Namespace) -> int:
    """0 where everything that the core needs works here, else 1."""
    from adaptsim_jax.commands import doctor_checks as doctor

    found = doctor.examine()
    if args.json:
        print(json.dumps(found, indent=1))
    else:
        doctor.show(found)
    return 1 if found["faults"] else 0
