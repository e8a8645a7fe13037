"""`adaptsim export`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from adaptsim_jax.mend.export import Diagnosis

EXAMPLES = """
  adaptsim export out --as mjcf                model.xml with its meshes beside it, in out/mjcf
  adaptsim export out --as playground          domain_randomize(model, rng) for MuJoCo Playground
  adaptsim export out --as mjlab --out robot   an actuator configuration with delays, and events
  adaptsim export out --as isaaclab --unchecked    without running it over the recordings
  adaptsim export out --as urdf --logs logs/new    run over other recordings
  adaptsim export out --as json                every number with unit, interval and correlations
"""
RUN_BY_MJX = ("playground", "brax")


def run(args: argparse.Namespace) -> int:
    """Write the files for another tool, and print which effects these hold."""
    from adaptsim_jax.commands.parser import next_step, output
    from adaptsim_jax.core.files import write_bytes
    from adaptsim_jax.mend.export import TOOLS, carried, read_diagnosis, written

    d = read_diagnosis(args.folder)
    files = written(d, args.form)
    with output(args.out or d.folder / args.form) as out:
        for name, content in files.items():
            (out / name).parent.mkdir(exist_ok=True)
            write_bytes(out / name, content)
    rows = carried(d, args.form)
    print(f"written for {TOOLS[args.form]}: {', '.join(str(out / name) for name in files)}")
    _table(("effect", "at", "arrived", ""), [(r.effect, r.where, r.how, r.why) for r in rows])
    if not args.unchecked:
        model = out / "model.xml" if "model.xml" in files else None
        _checked(d, model, args)
    next_step(f"export {args.folder} --as json    every number, for any other program")
    return 0


def _checked(d: Diagnosis, model: Path | None, args: argparse.Namespace) -> None:
    """Print errors over the recordings, or why there are none."""
    from adaptsim_jax.core import process
    from adaptsim_jax.report.diagnosis_format import quantity

    data = args.logs or d.form.provenance.get("data", "")
    if not data or not Path(data).exists():
        where = f"the recordings {data} are not here" if data else "no recordings are known"
        print(f"not run: {where}; give them by --logs")
        return
    if model is None:
        print(f"not run: {args.form} has no commands of actuators")
        return
    if "jax" not in sys.modules:
        process.small_steps()
    from adaptsim_jax.attribution.round_trip import DECLARED, HORIZON, round_trip

    found = round_trip(d.folder, model, data, args.form in RUN_BY_MJX)
    joints = list(found["model.toml"])
    print(f"\nmedian error over stretches of {HORIZON:g} s of {data}:")
    rows = [(name, *(quantity(e[j], "rad", 3) for j in joints)) for name, e in found.items()]
    _table(("", *joints), rows)
    declared = found[DECLARED]
    for name, error in found.items():
        worse = [j for j in joints if error[j] > declared[j]]
        if worse:
            print(f"{name}: WORSE than declared.xml at {', '.join(worse)}; see what was dropped")


def _table(head: tuple[str, ...], rows: list[tuple[Any, ...]]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(*head, box=None)
    for row in rows:
        table.add_row(*map(str, row))
    Console().print(table)
