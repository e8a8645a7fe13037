"""`adaptsim parity`."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator
from typing import Any

EXAMPLES = """
  adaptsim parity pendulum
  adaptsim parity pendulum --samples 200 --json
  adaptsim parity pushing --samples 200
  adaptsim parity scooping --samples 200
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    from adaptsim_jax.commands.common import positive

    parser.add_argument("task", metavar="TASK", help="pendulum, pushing or scooping")
    parser.add_argument(
        "--samples", type=positive, default=32, metavar="N", help="random samples (32)"
    )
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(args: argparse.Namespace) -> int:
    """Final-state differences of the backends over random parameters, commands and starts."""
    from adaptsim_jax.commands.common import check_task
    from adaptsim_jax.core.progress import progress

    check_task(args.task)
    from adaptsim_jax.tasks.parity import parity

    with progress(f"parity {args.task}") as report:
        found = parity(args.task, samples=args.samples, seed=args.seed, progress=report)
    if args.json:
        print(json.dumps(found, indent=1))
    elif args.task == "pushing":
        _show_pushing(found)
    elif args.task == "scooping":
        _show_scooping(found)
    else:
        _show(found)
    if not args.json:
        from adaptsim_jax.commands.common import next_step

        next_step(f"train {args.task} --run runs/a")
    return 0


def _show_pushing(found: dict[str, Any]) -> None:
    print(
        f"pushing: {found['samples']} random pushes of {found['seconds']:g} s, friction "
        f"{found['friction']};\n"
        f"distance between final positions of the bottle, mm\n"
    )
    keys = ("median_mm", "p90_mm", "p99_mm", "max_mm")
    head = f"{'median':>8} {'p90':>8} {'p99':>8} {'max':>8}"
    _pairs(found, 28, head, "push", lambda row: " ".join(f"{row[key]:8.3f}" for key in keys))
    print("\ndrake - drake_other_step is the ceiling: one engine at steps of 2 and 2.5 ms\n")
    print(f"{'engine':18} {'pushes/s':>10} {'pushes/CPU s':>13} {'first call':>11}")
    for row, wrong in _that_ran(found["engines"]):
        speeds = f"{row['pushes_per_second']:10.1f} {row['pushes_per_cpu_second']:13.1f} {row['first_call_s']:9.1f} s"
        print(f"{row['engine']:18} {speeds}{wrong}")


def _show_scooping(found: dict[str, Any]) -> None:
    print(
        f"scooping: {found['samples']} random trials of {found['seconds']:g} s; share that ended "
        f"alike, with 95 % intervals\n"
    )

    def interval(row):
        return f"{row['alike']:6.3f} {row['low']:6.3f} - {row['high']:5.3f}"

    _pairs(found, 36, f"{'alike':>6} {'interval':>14}", "trial", interval)
    print(
        "\ndrake with itself at another mesh or step is the ceiling; low: hardly any dissipation\n"
    )
    print(
        f"{'engine':18} {'success':>8} {'ellipsoid':>9} {'cylinder':>9} {'trials/s':>9} "
        f"{'per CPU s':>9} {'first call':>11}"
    )
    for row, wrong in _that_ran(found["engines"]):
        shapes = " ".join(
            f"{'-' if v is None else f'{v:.3f}':>9}" for v in row["success_by_shape"].values()
        )
        speeds = f"{row['trials_per_second']:9.1f} {row['trials_per_cpu_second']:9.1f} {row['first_call_s']:9.1f} s"
        print(f"{row['engine']:18} {row['success']:8.3f} {shapes} {speeds}{wrong}")


def _pairs(
    found: dict[str, Any], wide: int, head: str, noun: str, numbers: Callable[[dict[str, Any]], str]
) -> None:
    """The table of pairs of engines, their names `wide`; noun: what went well in neither where
    nothing was compared.
    """
    print(f"{'pair':{wide}} {head} {'compared':>9}")
    for row in found["pairs"]:
        if row["compared"]:
            told = f"{numbers(row)} {row['compared']:9}"
        else:
            told = f"no {noun} went well in both"
        print(f"{' - '.join(row['pair']):{wide}} {told}")


def _that_ran(engines: list[dict[str, Any]]) -> Iterator[tuple[dict[str, Any], str]]:
    """Each engine that ran, with what went wrong in it; those that did not are printed with the
    reason.
    """
    for row in engines:
        if row["ran"]:
            yield row, "".join(f"; {count}: {what}" for what, count in row["went_wrong"].items())
        else:
            print(f"{row['engine']:18} did not run: {row['why']}")


def _show(found: dict[str, Any]) -> None:
    print(
        f"{found['task']}: {found['samples']} random samples of {found['seconds']:g} s, double "
        f"precision;\n"
        f"differences of the final state from {found['reference']} MuJoCo, median and largest\n"
    )
    print(f"{'backend':12} {'angle [rad]':>19} {'velocity [rad/s]':>19} {'diverged':>9}")
    for row in found["rows"]:
        if not row["ran"]:
            print(f"{row['backend']:12} did not run: {row['why']}")
        elif "angle_median" not in row:
            print(f"{row['backend']:12} all {row['diverged']} samples diverged")
        else:
            pairs = [
                f"{row[f'{k}_median']:9.1e} {row[f'{k}_max']:9.1e}" for k in ("angle", "velocity")
            ]
            print(f"{row['backend']:12} {pairs[0]} {pairs[1]} {row['diverged']:9}")
