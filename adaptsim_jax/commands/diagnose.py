"""`adaptsim diagnose`."""

from __future__ import annotations

import argparse

EXAMPLES = """
  adaptsim diagnose logs/rig --out out          reads logs/rig/meta.toml and a CSV for each trial
  adaptsim diagnose logs/rig --out out2 --seed 1
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("data", metavar="DATA", help="a folder with meta.toml and one CSV or npz a trial")
    parser.add_argument("--out", required=True, metavar="DIR", help="folder for report.json, report.html, model.toml")


def run(args: argparse.Namespace) -> int:
    """Close the loop on a folder of measured data."""
    from adaptsim_jax.closeloop.recording import read_recording
    from adaptsim_jax.commands.common import output
    from adaptsim_jax.progress import progress

    recording = read_recording(args.data)  # refused within a second, and before JAX is loaded
    with output(args.out) as out, progress("diagnose") as report:
        from adaptsim_jax.closeloop.diagnose import diagnose

        result = diagnose(recording, out=out, seed=args.seed, progress=report)
    from rich.console import Console

    from adaptsim_jax.report.diagnosis import print_summary

    print_summary(result, Console(), out)
    return 0
