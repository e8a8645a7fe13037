"""`adaptsim replay`."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from pathlib import Path

EXAMPLES = """
  adaptsim replay robot.xml logs/robot                    error over stretches of 0.5 s, as declared
  adaptsim replay out/model.toml logs/validation --json   the mended model on other data
  adaptsim replay out/model.xml logs/robot --horizon 0    every trial in one go
  adaptsim replay robot.urdf run.mcap --out replay        with a figure of measured against simulated
  adaptsim replay robot.xml logs/robot --simulator mujoco    by MuJoCo itself, at the file's own step
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", metavar="MODEL", help="an MJCF or URDF file, or the model.toml of a diagnosis")
    parser.add_argument("data", metavar="DATA", help="a folder with meta.toml, or one log (CSV, NPZ, bag, MCAP)")
    parser.add_argument(
        "--horizon",
        type=_horizon,
        default=0.5,
        metavar="S",
        help="length of the stretches; 0: whole trials (default 0.5)",
    )
    parser.add_argument(
        "--simulator",
        choices=("tree", "mujoco"),
        help="tree: joints on a base that stands still; mujoco: whatever MuJoCo compiles, at the file's own step (default: tree "
        "where it can, mujoco where it must)",
    )
    parser.add_argument("--json", action="store_true", help="print all of it as JSON")
    parser.add_argument("--out", metavar="DIR", help="folder for replay.json and replay.png")


def _horizon(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value < 1e4:
        raise argparse.ArgumentTypeError(f"'{text}' is no length of time; give seconds, or 0 for whole trials")
    return value


def run(args: argparse.Namespace) -> int:
    """Simulate a model over recordings, from starts fitted to each stretch by plain least squares; what the motion
    contradicts of the recording's columns and units is told, not refused."""
    from adaptsim_jax.attribution.replay import replay_files
    from adaptsim_jax.core import compile_flags
    from adaptsim_jax.core.files import output_folder, write_json

    if "jax" not in sys.modules:
        compile_flags.small_steps()
    found = replay_files(args.model, args.data, args.horizon, args.simulator)
    told = {"model": args.model, "data": args.data, **found.told()}
    if args.out is not None:
        from adaptsim_jax.report.replay_figure import save

        folder = output_folder(args.out)
        write_json(folder / "replay.json", told)
        save(found, folder / "replay.png")
    if args.json:
        print(json.dumps(told, indent=2))
    else:
        from adaptsim_jax.commands.common import next_step

        _print(told)
        if (Path(args.model).parent / "report.json").exists():  # what `diagnose` wrote
            next_step(f"replay {shlex.quote(args.model)} OTHER    over a recording that had no part in the diagnosis")
        else:
            next_step(f"diagnose {shlex.quote(args.data)} --out out    what does the declared model lack?")
    return 0


def _print(told: dict) -> None:
    from rich.box import HEAVY_HEAD
    from rich.console import Console
    from rich.table import Table

    from adaptsim_jax.report.diagnosis_format import quantity

    console = Console()
    title = f"error over {told['horizon']:g} s, {told['stretches']} stretches"
    box = HEAVY_HEAD if console.is_terminal else None  # a program or a file gets columns without a frame
    table = Table("", "median", "rms", "ran away", title=title, box=box, title_justify="left")
    size = lambda row, unit: (
        quantity(row["median"], unit, 4),
        quantity(row["rms"], unit, 4, like=row["median"]),
        f"{100 * row['ran_away']:.0f} %",
    )
    table.add_row("all", *size(told, told["unit"]))
    for name, row in told["joints"].items():
        table.add_row(name, *size(row, row["unit"]))
    for name, row in told["trials"].items():
        table.add_row(f"trial {name}", *size(row, told["unit"]))
    console.print(table)
    for note in told["notes"]:
        print(f"note: {note}")
