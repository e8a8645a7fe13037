"""The parser of one command, for the command line, for completion and for the reference page."""

from __future__ import annotations

import argparse
import importlib
from typing import NoReturn

from adaptsim_jax import __version__
from adaptsim_jax.commands import SUMMARIES, common
from adaptsim_jax.core.errors import BadInput


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
    _declare(parser, module)
    return parser


def _declare(parser: argparse.ArgumentParser, module) -> None:
    module.arguments(parser)
    shared = parser.add_argument_group("shared by all commands")
    shared.add_argument("--seed", type=common.seed, metavar="N", help="random seed (default 0)")
    shared.add_argument("--no-cache", action="store_true", help="keep no compiled programs on disk")
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
        _declare(commands.add_parser(name, help=summary), module)
    return parser
