"""The parser of one command, for the command line, for completion and for the reference page."""

from __future__ import annotations

import argparse
import contextlib
import importlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn

from adaptsim_jax import __version__
from adaptsim_jax.commands import SUMMARIES
from adaptsim_jax.core import config
from adaptsim_jax.core.errors import MAX_SEED, BadInput
from adaptsim_jax.tasks.registry import TASKS

# ---------------------------------------------------------------- what commands share
#
# What several commands share: tasks, targets, seeds and counts by the words a person types.


def check_task(task: str) -> str:
    """`task` if it is known; BadInput with the nearest name otherwise."""
    return config.pick("task", task, TASKS)


def task_word(args: argparse.Namespace) -> str:
    """The task that `args.task` names, a task's own name or an env.toml: its table is then
    `args.env`, else empty.
    """
    args.env = {}
    if args.task.endswith(".toml"):
        from adaptsim_jax.environments.setting import read_env

        args.env = read_env(args.task)
        if getattr(args, "diagnosis", None):
            from adaptsim_jax.environments.diagnosed import diagnosed

            args.env["task"] = diagnosed(args.env.get("task", {}), args.diagnosis)
        return "environment"
    if getattr(args, "diagnosis", None):
        raise BadInput(f"--diagnosis: '{args.task}' is no env.toml; give --model instead")
    return check_task(args.task)


@contextlib.contextmanager
def output(path: str | Path) -> Iterator[Path]:
    """The folder `path` to write into, made if need be. Where the work fails before it wrote
    anything, it is gone again.
    """
    from adaptsim_jax.core.files import output_folder

    new = not Path(path).exists()
    out = output_folder(path)
    try:
        yield out
    except BaseException:
        if new:
            with contextlib.suppress(OSError):  # not empty: what is there is whole
                out.rmdir()
        raise


def read_target(text: str, task: Any) -> tuple[str, Any, Any]:
    """`(name, params [D], world)` of a target: a setting of `task`, or a TOML file that names every
    parameter.

    The parameters stand at the top of the file or under `[params]`; all are checked against
    physical ranges. Where a target has more than parameters of Omega (any field of an environment,
    a `model.toml`), `world` is `task` with that to act in, else None.
    """
    if text in task.settings:
        world = None if task.world is None else task.world(text)
        return text, task.space.values(task.settings[text], text), world
    path = Path(text)
    if not path.exists():
        known = (*task.settings, "a TOML file of parameters")
        raise BadInput(f"unknown target '{text}', and no such file; {config.suggest(text, known)}")
    if task.world is not None:
        world = task.world(path)
        return path.stem, world.space.values(world.settings[path.stem], str(path)), world
    table = config.read(path)
    if "schema" in table:
        raise BadInput(
            f"{path}: a model.toml is a target of environments (env.toml); give the parameters of "
            f"{task.name}, such as {task.space.names[0]} = ..."
        )
    if "params" in table:
        for key in table:
            if key != "params":
                raise BadInput(f"{path}: unknown key '{key}' beside [params]; remove it")
        table = table["params"]
        if not isinstance(table, dict):
            raise BadInput(
                f"{path}: 'params' is not a table; write [params] and a line for each parameter"
            )
    return path.stem, task.space.values(table, str(path)), None


def seed(text: str) -> int:
    """A seed of JAX: an integer in [0, 2^32)."""
    return _whole(text, 0, MAX_SEED)


def positive(text: str) -> int:
    """A count of at least one."""
    return _whole(text, 1, 10**9)


def _whole(text: str, low: int, high: int) -> int:
    try:
        value = int(text)
    except ValueError:
        value = low - 1
    if not low <= value <= high:
        raise argparse.ArgumentTypeError(
            f"'{text}' is not a whole number from {low} to {high}; try {low}"
        )
    return value


def next_step(command: str) -> None:
    """The line that says what a person may do now; the last of a command's output."""
    print(f"next: adaptsim {command}")


def print_file(path: Path) -> None:
    """What `--json` prints of a command that writes its answer to a file."""
    print(path.read_text(encoding="utf-8"), end="")


# ---------------------------------------------------------------- lengths of stretches

LONGEST = 1e4
"""s that no stretch reaches."""


def length(text: str) -> float:
    """Seconds, or 0 for whole trials."""
    if not 0.0 <= (value := _seconds(text)) < LONGEST:
        raise argparse.ArgumentTypeError(
            f"'{text}' is no length of time; give seconds, or 0 for whole trials"
        )
    return value


def stretch(text: str) -> float:
    """Seconds above 0."""
    if not 0.0 < (value := _seconds(text)) < LONGEST:
        raise argparse.ArgumentTypeError(
            f"'{text}' is no length of a stretch; give seconds above 0 (whole trials: --yardstick "
            "whole)"
        )
    return value


def _seconds(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return -1.0


class Parser(argparse.ArgumentParser):
    """argparse that reports bad input as everything else here does: one line, code 2, the nearest
    name.
    """

    def __init__(self, *args, **kwargs):
        kwargs.setdefault("formatter_class", argparse.RawDescriptionHelpFormatter)
        super().__init__(*args, allow_abbrev=False, **kwargs)

    def error(self, message: str) -> NoReturn:
        raise BadInput(f"{message.removeprefix('argument ')}; see '{self.prog} --help'")


def command_parser(name: str) -> Parser:
    """Of the command `name`, one of `SUMMARIES`; loads its module and nothing else. Its `run` is
    the module's.
    """
    module = importlib.import_module(f"adaptsim_jax.commands.{name}")
    parser = Parser(
        prog=f"adaptsim {name}",
        description=f"{SUMMARIES[name]}.",
        epilog=f"examples:\n{module.EXAMPLES.rstrip()}",
    )
    _declare(parser, name, module)
    return parser


KINDS = {
    "seed": seed,
    "count": positive,
    "length": length,
    "stretch": stretch,
    "int": int,
    "float": float,
    "path": Path,
}
"""What a value of `options.toml` is read by."""
ACTIONS = {"flag": "store_true", "repeated": "append"}


def _declare(parser: argparse.ArgumentParser, name: str, module: Any) -> None:
    """The options of the command `name`, then those that all commands share."""
    tables = config.read(Path(__file__).with_name("options.toml"))
    places: dict[str, Any] = {}
    for option, row in (tables[name] | tables["shared"]).items():
        group, either = row.pop("group", None), row.pop("either", None)
        if group and group not in places:
            places[group] = parser.add_argument_group(group)
        if either and either not in places:
            places[either] = parser.add_mutually_exclusive_group()
        kind = row.pop("kind", None)
        if kind in ACTIONS:
            row["action"] = ACTIONS[kind]
        elif kind:
            row["type"] = KINDS[kind]
        places.get(group or either, parser).add_argument(option, **row)
    parser.set_defaults(run=module.run)


def top_parser() -> Parser:
    """Of what may stand before a command."""
    lines = "\n".join(f"  {name:10} {summary}" for name, summary in SUMMARIES.items())
    parser = Parser(
        prog="adaptsim",
        usage="adaptsim [-h] [--version] COMMAND ...",
        description="Find simulation parameters that make a task policy work in a target "
        "environment,\n"
        "and trace what a simulator lacks from measured data.",
        epilog=f"commands:\n{lines}\n\n'adaptsim COMMAND --help' shows its options and examples.",
    )
    parser.add_argument("--version", action="version", version=f"adaptsim_jax {__version__}")
    return parser


def whole_parser() -> Parser:
    """Of the command line with all its commands; loads every command's module."""
    parser = top_parser()
    commands = parser.add_subparsers(metavar="COMMAND")
    for name, summary in SUMMARIES.items():
        module = importlib.import_module(f"adaptsim_jax.commands.{name}")
        _declare(commands.add_parser(name, help=summary), name, module)
    return parser
