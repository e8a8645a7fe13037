"""`adaptsim train`."""

from __future__ import annotations

import argparse
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

from adaptsim_jax.core.config import Table

EXAMPLES = """
  adaptsim train pendulum --run runs/a
  adaptsim train pendulum --run runs/a --resume        go on after a kill, to the same bits
  adaptsim train pendulum --run runs/b --seed 3 --set phase1.trajectories=20000 --set hyper.delta=0.15
  adaptsim train pendulum --run runs/c --config runs/a/config.toml
  adaptsim train pushing --run runs/p
  adaptsim train pushing --run runs/q --preset paper-pushing       as the paper trains it: a policy at each visit
  adaptsim train examples/env.toml --run runs/e                    an environment: Playground's, gymnax's, or your own
  adaptsim train env.toml --run runs/f --diagnosis out             Omega and E's first mean from randomisation.toml
  adaptsim train pushing --run runs/m --model out/model.toml       on the model that `adaptsim diagnose` mended; adapt, compare and robot then go by it
"""  # noqa: E501


def run(args: argparse.Namespace) -> int:
    """Phase 1 into a run folder."""
    from adaptsim_jax.commands.parser import task_word
    from adaptsim_jax.core.files import one_writer

    text, args.task = args.task, task_word(args)
    from adaptsim_jax.adaptation.training import train_run
    from adaptsim_jax.core.progress import progress

    args.resume_hint = (
        f"continue with: adaptsim train {shlex.quote(text)} --run {shlex.quote(args.folder)} "
        "--resume"
    )
    folder = _folder(args)
    with one_writer(folder.path), progress(f"train {text}") as report:
        trained = train_run(config_of(folder.config, args), folder, report)
    settings = list(trained.phase1.task.settings)
    target = "ood-1" if "ood-1" in settings else settings[0]
    print(
        f"trained: {folder.path}; next: adaptsim adapt {shlex.quote(args.folder)} --target {target}"
    )
    return 0


def config_of(table: Table, args: argparse.Namespace) -> Any:
    """The config in `table`, with what the command line changes."""
    from adaptsim_jax.adaptation.training import TrainConfig, with_defaults
    from adaptsim_jax.core import config

    start = config.from_table(
        TrainConfig, with_defaults(args.task, table), args.config or f"{args.folder}/config.toml"
    )
    if args.model:
        start = replace(start, task=dict(start.task) | _of_model(args))
    settings = [*args.set, *([f"seed={args.seed}"] if args.seed_given else [])]
    return config.with_settings(start, settings)


def _of_model(args: argparse.Namespace) -> Table:
    """Options of the task by `--model`; they go into the run's config, which is then whole without
    the file.
    """
    from adaptsim_jax.core import config
    from adaptsim_jax.core.errors import BadInput
    from adaptsim_jax.tasks.registry import TASKS

    table, kind = config.read(args.model), TASKS[args.task]
    if kind.of_model is None:
        raise BadInput(
            f"--model: policies of task '{args.task}' are trained on no mended model; name it in "
            "env.toml instead, and give --env"
        )
    if table.get("task") != args.task:
        raise BadInput(
            f"{args.model}: is of task '{table.get('task')}', not '{args.task}'; name another file"
        )
    options = kind.of_model(table, args.model)
    for name in options.pop("left_out", ()):
        print(
            f"{args.model}: {name} is of the measurement, not of the simulator; it is left out: "
            "mend what measures"
        )
    return options


def _folder(args: argparse.Namespace) -> Any:
    from adaptsim_jax.core import config
    from adaptsim_jax.core.errors import BadInput
    from adaptsim_jax.core.store import RunFolder

    if not args.folder.strip():
        raise BadInput("--run: names no folder; give one, such as runs/a")
    if args.resume:
        if args.config or args.preset or args.env:
            table = _start_table(args)
        else:
            table = RunFolder.open(args.folder, task=args.task).config
    else:
        table = _start_table(args)
    asked = config_of(table, args)
    _check(asked, args)
    start = RunFolder.resume if args.resume else RunFolder.create
    return start(Path(args.folder), config.to_table(asked), task=args.task)


def _check(asked: Any, args: argparse.Namespace) -> None:
    """Refuse a config that cannot be run before a folder is made for it."""
    from adaptsim_jax.adaptation.phase1 import make_phase1
    from adaptsim_jax.tasks.registry import make_task

    make_phase1(make_task(args.task, asked.task, args.config or "--set"), asked.phase1)


def _start_table(args: argparse.Namespace) -> Table:
    """The config of a file (a run's, or a bare table) or of a preset, or the defaults."""
    from adaptsim_jax.adaptation.training import table_of

    if args.preset:
        return _preset_table(args)
    if not args.config:
        return vars(args).get("env", {})  # of an env.toml in the task's place
    return table_of(args.config, args.task, args.config)


def _preset_table(args: argparse.Namespace) -> Table:
    from adaptsim_jax.adaptation.training import preset, presets_of
    from adaptsim_jax.core import config
    from adaptsim_jax.core.errors import BadInput

    names = presets_of(args.task)
    if args.preset not in names:
        known = " or ".join(names) if names else f"none of {args.task}'s"
        raise BadInput(f"--preset: '{args.preset}' is unknown; there is {known}")
    return config.to_table(preset(args.preset))
