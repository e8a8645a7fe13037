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
  adaptsim replay robot.xml logs/robot --fit body:tool.mass 'geom:*foot*.friction[0]'    these numbers fitted by MuJoCo
"""  # noqa: E501


def run(args: argparse.Namespace) -> int:
    """Simulate a model over recordings, from starts fitted to each stretch by plain least squares;
    what the motion contradicts of the recording's columns and units is told, not refused.
    """
    from adaptsim_jax.attribution.replay import replay_files
    from adaptsim_jax.core import process
    from adaptsim_jax.core.files import output_folder, write_json

    if "jax" not in sys.modules:
        process.small_steps()
    if args.fit:
        return _fit(args)
    asked = {None: None, "all": ("stretches", "whole", "torque")}.get(
        args.yardstick, ("stretches", args.yardstick)
    )
    found = replay_files(args.model, args.data, args.horizon, asked, args.simulator)
    answer = {"model": args.model, "data": args.data, **found.as_dict()}
    if args.out is not None:
        from adaptsim_jax.report.diagnosis_figures import save_replay

        folder = output_folder(args.out)
        write_json(folder / "replay.json", answer)
        save_replay(found, folder / "replay.png")
    if args.json:
        print(json.dumps(answer, indent=2))
    else:
        from adaptsim_jax.commands.parser import next_step

        _print(answer)
        if (Path(args.model).parent / "report.json").exists():  # what `diagnose` wrote
            next_step(
                f"replay {shlex.quote(args.model)} OTHER    over a recording that had no part in "
                "the diagnosis"
            )
        else:
            next_step(
                f"diagnose {shlex.quote(args.data)} --out out    what does the declared model lack?"
            )
    return 0


def _fit(args: argparse.Namespace) -> int:
    """Fit numbers of the model by MuJoCo and print them with what they leave."""
    from adaptsim_jax.core.errors import BadInput
    from adaptsim_jax.core.files import output_folder, write_json
    from adaptsim_jax.logs.read import read_source_and_log
    from adaptsim_jax.simulators.mujoco.fit import fit

    if args.simulator == "tree":
        raise BadInput(
            "--fit fits by the simulator mujoco; leave --simulator tree out, or run adaptsim "
            "diagnose"
        )
    source, log = read_source_and_log(args.data, args.model)
    found = fit(source, log, args.fit, args.horizon or 0.5)
    answer = {
        "model": args.model,
        "data": args.data,
        "fitted": found.as_dict(),
        "before": found.before,
        "after": found.after,
        "code": found.code,
    }
    if args.out is not None:
        write_json(output_folder(args.out) / "fitted.json", answer)
    if args.json:
        print(json.dumps(answer, indent=2))
        return 0
    for name, row in answer["fitted"].items():
        print(
            f"{name} = {row['value']:.6g} [{row['low']:.6g}, {row['high']:.6g}] (file "
            f"{row['file']:.6g})"
        )
    print(
        f"residuals, weighted: {found.before:.4g} with the file's numbers, {found.after:.4g} with "
        f"these ({found.code})"
    )
    return 0


def _print(answer: dict) -> None:
    from rich.box import HEAVY_HEAD
    from rich.console import Console
    from rich.table import Table

    from adaptsim_jax.report.diagnosis_format import quantity

    console = Console()
    title = f"error over {answer['horizon']:g} s, {answer['stretches']} stretches"
    # a program or a file gets columns without a frame
    if console.is_terminal:
        box = HEAVY_HEAD
    else:
        box = None
    table = Table(
        "",
        "median",
        "rms",
        "straight line",
        "still",
        "skill",
        "ran away",
        title=title,
        box=box,
        title_justify="left",
    )

    def size(row, unit):
        references = ("straight_line", "hold_still")
        skill = f"{row['skill']:.2f}" if row.get("skill") is not None else ""
        return (
            quantity(row["median"], unit, 4),
            quantity(row["rms"], unit, 4, like=row["median"]),
            *(quantity(row[k], unit, 3) if k in row else "" for k in references),
            skill,
            f"{100 * row['ran_away']:.0f} %",
        )

    table.add_row("all", *size(answer, answer["unit"]))
    for name, row in answer["joints"].items():
        table.add_row(name, *size(row, row["unit"]))
    for name, row in answer["trials"].items():
        table.add_row(f"trial {name}", *size(row, answer["unit"]))
    console.print(table)
    for name, measure in answer["yardsticks"].items():
        if name != "stretches":
            console.print(_measured(name, measure, box))
    if answer["predicts_nothing"]:
        print(
            "This model predicts nothing: by no yardstick does it do better than what needs no "
            "model."
        )
    for note in answer["notes"]:
        print(f"note: {note}")


def _measured(name: str, measure: dict, box):
    """The table of a yardstick, by joint."""
    from rich.table import Table

    from adaptsim_jax.report.diagnosis_format import quantity

    if name == "torque":
        keys, words = ("missing", "torque", "constant"), ("missing", "torque", "about its mean")
        what = "torque along the measured motion"
    else:
        keys, words = ("error", "straight_line", "hold_still"), ("error", "straight line", "still")
        what = f"whole trials, {measure['span_s']:.3g} s"
    table = Table(
        "",
        *words,
        "skill",
        title=f"{what}: skill {measure['skill']:.2f}",
        box=box,
        title_justify="left",
    )
    for joint, row in measure["joints"].items():
        table.add_row(
            joint, *(quantity(row[k], row["unit"], 3) for k in keys), f"{row['skill']:.2f}"
        )
    return table
