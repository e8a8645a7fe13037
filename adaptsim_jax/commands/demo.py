"""`adaptsim demo`."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
from pathlib import Path

EXAMPLES = """
  adaptsim demo
  adaptsim demo --out demo_out --seed 1
  adaptsim demo --full --out demo_full         larger sizes, films, a second diagnosis
"""

TITLES = {
    "pendulum": "pendulum: learn to adapt, then adapt",
    "baselines": "pendulum: other methods, and a map",
    "push": "push: before and after adaptation",
    "scoop": "scoop: before and after adaptation",
    "diagnosis": "diagnosis: what a model lacks",
    "double": "diagnosis of a double pendulum",
    "page": "figures and page",
}


def run(args: argparse.Namespace) -> int:
    """The tour, on small sizes unless `--full`."""
    from adaptsim_jax.core.files import output_folder
    from adaptsim_jax.core.parallel import cores
    from adaptsim_jax.core.progress import parts_progress

    out = output_folder(args.out)
    again = f"adaptsim demo{' --full' * args.full} --out {shlex.quote(args.out)} --seed {args.seed}"
    args.resume_hint = f"continue with: {again}"
    print(
        "A pendulum, a push and a scoop are adapted to targets that the simulator is wrong "
        f"about, and a recording is diagnosed: {'a long while' if args.full else 'some minutes'} "
        "on two cores.",
        flush=True,
    )
    if "jax" not in sys.modules:  # else a Python program called us, which may have compiled already
        _set_up_computing()
    with parts_progress(TITLES) as report:
        from adaptsim_jax.commands.demo_config import FULL, SHORT
        from adaptsim_jax.commands.demo_tour import demo

        tour = demo(out, args.seed, report, FULL if args.full else SHORT, two_processes=cores() > 1)
    _show(tour, out)
    return 0


def _set_up_computing() -> None:
    from adaptsim_jax.core import process

    # the tour is small loops, and most of its time goes into compiling them
    process.small_steps()
    # two processes: by default each would take three quarters of a GPU's memory at once
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")


def _show(tour, out: Path) -> None:
    from adaptsim_jax.report.demo_page import summary

    rows = summary(tour, out)
    width = max(len(name) for name, _ in rows)
    print()
    for name, words in rows:
        print(f"{name:{width}}  {words}")
