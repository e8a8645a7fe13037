"""`adaptsim demo`."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path

EXAMPLES = """
  adaptsim demo
  adaptsim demo --out demo_out --seed 1
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--out", default="demo_out", metavar="DIR", help="default: demo_out")


def run(args: argparse.Namespace) -> int:
    """The tour on small sizes."""
    from adaptsim_jax.core.files import output_folder
    from adaptsim_jax.core.progress import progress

    out = output_folder(args.out)
    args.resume_hint = f"continue with: adaptsim demo --out {shlex.quote(args.out)} --seed {args.seed}"
    print(
        "train a small Phase 1, adapt to OOD-1 beside the baselines, diagnose a sample recording; a few minutes",
        flush=True,
    )
    with progress("demo") as report:
        from adaptsim_jax.commands.demo_tour import demo

        tour = demo(out, args.seed, report)
    _show(tour, out)
    return 0


def _show(tour, out: Path) -> None:
    from adaptsim_jax.report.demo_page import summary

    rows = summary(tour, out)
    width = max(len(name) for name, _ in rows)
    print()
    for name, words in rows:
        print(f"{name:{width}}  {words}")
