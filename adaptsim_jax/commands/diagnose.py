"""`adaptsim diagnose`."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import BadInput

if TYPE_CHECKING:
    from adaptsim_jax.logs.log import Log

EXAMPLES = """
  adaptsim diagnose logs/rig --out out          reads logs/rig/meta.toml and a CSV for each trial
  adaptsim diagnose logs/rig --out out2 --seed 1
  adaptsim diagnose logs/rig --out out3 --exclude backlash hard_stop        what this rig cannot have
  adaptsim diagnose logs/robot --out out4       any mechanism: meta.toml says task = "mechanism", model = "robot.xml"
  adaptsim diagnose day1 day2 day3 --out out13  one machine on several days: pooled, and which day contradicts the others
  adaptsim diagnose logs/pushes --out out6      the push: meta.toml says task = "pushing"; actions.csv and tracks beside it
  adaptsim diagnose logs/scoops --out out8      the scoop: task = "scooping", likewise
  adaptsim diagnose logs/tosses --out out9      a tossed body: task = "toss", model = "cube.xml"; poses beside it
  adaptsim diagnose robot --out out7            a session of `adaptsim robot` of either, as it is
  adaptsim diagnose logs/walk --out out11 --simulator mujoco     a base that moves, contact: by MuJoCo itself
  adaptsim diagnose logs/tanks --out out12 --simulator tanks.py:of_folder       a simulator of your own
  adaptsim diagnose run.mcap --model robot.urdf --out out5                  a log by itself, and a better robot.xml back
"""  # noqa: E501


def run(args: argparse.Namespace) -> int:
    """Close the loop on a folder of measured data."""
    from adaptsim_jax.commands.parser import output
    from adaptsim_jax.core import process
    from adaptsim_jax.core.progress import progress

    several = len(args.data) > 1
    for path in args.data:
        check_folders(Path(path), Path(args.out))
    args.data = tuple(args.data) if several else args.data[0]
    if "jax" not in sys.modules:  # else a Python program called us, which may have compiled already
        process.small_steps()
    named = args.simulator not in (None, "tree", "mujoco")
    if named and several:
        raise BadInput(f"--simulator {args.simulator}: takes one DATA; several logs are of a tree")
    task = None if several or named or args.model else trials_task(Path(args.data))
    if named:
        read = own_simulator
    elif task:
        read = diagnose_trials
    elif several or args.model is not None or of_a_mechanism(Path(args.data)):
        read = mechanism
    else:
        read = pendulum
    if args.rerun:
        check_rerun(read, several)
    judge = read(args, split_names(args.without))  # refused before anything is written
    from adaptsim_jax.diagnosis.written import faults_into
    from adaptsim_jax.mend.randomisation import write_randomisation

    with output(args.out) as out, faults_into(out), progress("diagnose") as report:
        result = judge(out=out, exclude=tuple(args.exclude), progress=report)
        write_randomisation(out)
        if args.rerun:
            write_rerun(Path(args.data), out)
    return print_answer(args, result, out, replays=task is None and not named)


def check_rerun(read: Any, several: bool) -> None:
    """BadInput where no recording for Rerun can be made."""
    from adaptsim_jax.report.rerun import rerun_module

    if several or read not in (mechanism, pendulum):
        raise BadInput("--rerun: shows one log of a machine of joints; leave it out")
    rerun_module()


def write_rerun(data: Path, out: Path) -> None:
    """Write `report.rrd` of the declared and the mended model, over the recordings."""
    import mujoco

    from adaptsim_jax.attribution.replay import replay_files
    from adaptsim_jax.report.rerun import NAME, save_rerun

    names = ("declared", "declared.xml"), ("mended", "model.xml"), ("mended", "model.toml")
    files = {name: out / file for name, file in names if (out / file).exists()}
    if not files:
        print(f"no {NAME}: no model was written", file=sys.stderr)
        return
    replays = {name: replay_files(file, data) for name, file in files.items()}
    shapes = files.get("declared", out / "model.xml")
    save_rerun(out / NAME, replays, mujoco.MjModel.from_xml_path(str(shapes)))


def check_folders(data: Path, out: Path) -> None:
    """BadInput where the report would lie among the recordings, and be taken for one of them the
    next time.
    """
    if data.is_dir() and out.exists() and out.resolve() == data.resolve():
        raise BadInput(f"--out {out}: is the folder of the recordings; name another")


def split_names(names: list[str]) -> list[str]:
    """`03,05` as two names."""
    return [part for name in names for part in name.split(",") if part]


def of_a_mechanism(data: Path) -> bool:
    """Whether DATA is a log of a mechanism: a file, or a folder whose meta.toml says so."""
    from adaptsim_jax.logs.declared import declared_task

    if data.is_dir():
        return declared_task(data) == "mechanism"
    return data.exists()


def trials_task(data: Path) -> str | None:
    """Which task of short trials DATA holds, a folder of them or a session of `adaptsim robot`;
    None where it is something else.
    """
    from adaptsim_jax.logs.declared import declared_task

    if (data / "robot.toml").exists():
        from adaptsim_jax.commands.robot_session import session_task

        return session_task(data)
    from adaptsim_jax.tasks.registry import TRIALS

    task = declared_task(data)
    if task in TRIALS:
        return task
    return None


Judge = Callable[..., Table]
"""What is left to do of recordings that were read: `(out, exclude, progress) -> report`."""


def pendulum(args: argparse.Namespace, without: list[str]) -> Judge:
    """A recording of the double pendulum, refused within a second and before JAX is loaded."""
    from adaptsim_jax.logs.pendulum import read_pendulum

    return partial(
        diagnose,
        read_pendulum(args.data, without=without),
        without=without,
        as_declared=args.as_declared,
    )


def own_simulator(args: argparse.Namespace, without: list[str]) -> Judge:
    """Whatever a function of the user's makes of DATA, which is that function's alone to read."""
    from adaptsim_jax.diagnosis.run import command_of
    from adaptsim_jax.diagnosis.simulated import diagnose_simulator
    from adaptsim_jax.diagnosis.simulator import simulator_named
    from adaptsim_jax.report.diagnosis import write_diagnosis

    for option in ("without", "model", "as_declared", "yardstick", "horizon"):
        if getattr(args, option):
            raise BadInput(
                f"--{option.replace('_', '-')}: a simulator of your own reads DATA itself; leave "
                "the option out"
            )
    simulator = simulator_named(args.simulator)(Path(args.data))
    command = partial(command_of, args.data, simulator=args.simulator)
    return lambda out, exclude, progress: diagnose_simulator(
        simulator,
        out=out,
        exclude=exclude,
        progress=progress,
        page=write_diagnosis,
        name=args.simulator,
        command=command(out=out, exclude=exclude),
    )


def diagnose_trials(args: argparse.Namespace, without: list[str]) -> Judge:
    """Measured trials of a task: effects judged one by one, the mended model, and the trials that
    tell a class apart.
    """
    from adaptsim_jax.report.diagnosis import write_diagnosis
    from adaptsim_jax.tasks.registry import TRIALS

    data = Path(args.data)
    kind = TRIALS[str(trials_task(data))]
    read = kind.read
    if (data / "robot.toml").exists():
        from adaptsim_jax.commands.robot_session import recorded_trials as read
    recorded = read(data, args.as_declared, without)
    asked = {"data": str(data), "without": without, "as_declared": args.as_declared}
    return partial(kind, recorded, page=write_diagnosis, asked=asked)


def mechanism(args: argparse.Namespace, without: list[str]) -> Judge:
    """Any mechanism: effects judged one by one, and the model file with what is named."""
    from adaptsim_jax.logs.read import joined, read_source_and_log

    source, log = read_source_and_log(args.data, args.model)
    from adaptsim_jax.attribution.choice import chosen
    from adaptsim_jax.attribution.criteria import CHOICE
    from adaptsim_jax.diagnosis.run import command_of
    from adaptsim_jax.report.diagnosis import write_diagnosis

    horizon = args.horizon or CHOICE.horizon
    if chosen(source, log, args.simulator, horizon).simulator == "mujoco":
        from adaptsim_jax.attribution.replay import recommended
        from adaptsim_jax.simulators.mujoco.diagnosed import diagnose as by_mujoco
        from adaptsim_jax.simulators.mujoco.diagnosed import simulator

        spans = {f"stretches of {horizon:g} s": horizon}
        if without:
            log = log.pick([t.name for t in log.trials if t.name not in without])
        command = partial(
            command_of,
            args.data,
            model=args.model,
            without=without,
            simulator=args.simulator,
            horizon=args.horizon,
        )
        verify = recommended(args.data, args.model, "mujoco", spans, without)
        return lambda out, exclude, progress: by_mujoco(
            replace(simulator(source, log, args.horizon), verify=verify),
            page=write_diagnosis,
            out=out,
            exclude=exclude,
            progress=progress,
            command=command(out=out, exclude=exclude),
        )
    joined(source, log)
    given = {} if args.horizon is None else {"horizon": args.horizon}
    return partial(
        diagnose,
        args.data,
        model=args.model,
        without=tuple(without),
        as_declared=args.as_declared,
        yardstick=args.yardstick,
        **given,
    )


def print_answer(args: argparse.Namespace, result: Table, out: Path, replays: bool) -> int:
    """The summary for a person and what to do next, or all of the report as JSON. replays: Whether
    `replay` takes the model.
    """
    from adaptsim_jax.commands.parser import next_step, print_file

    if args.json:
        print_file(out / "report.json")
        return 0
    from rich.console import Console

    from adaptsim_jax.report.diagnosis import print_summary

    print_summary(result, Console(), out)
    model = next(
        (out / name for name in ("model.toml", "model.xml") if (out / name).exists()), None
    )
    if replays and model is not None and args.model is None:
        from adaptsim_jax.logs.pool import paths_of

        which = "mended" if result["effects"] else "fitted"
        next_step(
            f"replay {shlex.quote(str(model))} {shlex.quote(str(paths_of(args.data)[0]))}    the "
            f"{which} model over a recording"
        )
    return 0


def diagnose(data: str | Path | Sequence[str | Path] | Log, **options: Any) -> Table:
    """Which effects recorded trials show that their declared model lacks.

    Args:
        data: A folder with `meta.toml`, one log (with `model=`), several of one mechanism, or the
            log of a double pendulum that was read.
        options: `out` (folder for report, page and mended models), `model`, `exclude`, `without`,
            `effects`, `criteria`, `progress`, `as_declared`, as far as the data's task has them
            (`attribution.diagnose.diagnose`, `attribution.pendulum_diagnosis.diagnose_pendulum`).

    Returns:
        The report, as `report.json` holds it (`diagnosis.schema`). Raises BadInput where the data
        or the model cannot be read.
    """
    from adaptsim_jax.report.diagnosis import write_diagnosis

    options.setdefault("page", write_diagnosis)
    one = isinstance(data, (str, Path))
    if isinstance(data, (list, tuple)) or (
        one and (options.get("model") is not None or of_a_mechanism(Path(data)))
    ):
        from adaptsim_jax.attribution.diagnose import diagnose as of_mechanism

        return of_mechanism(data, **options)
    from adaptsim_jax.attribution.pendulum_diagnosis import diagnose_pendulum

    return diagnose_pendulum(data, **options)
