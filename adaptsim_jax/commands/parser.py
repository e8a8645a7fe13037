"""The parser of one command, for the command line, for completion and for the reference page."""

from __future__ import annotations

import argparse
import importlib
from typing import NoReturn

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
    module.arguments(parser)
    shared = parser.add_argument_group("shared by all commands")
    shared.add_argument("--seed", type=common.seed, metavar="N", help="random seed (default 0)")
    shared.add_argument("--no-cache", action="store_true", help="keep no compiled programs on disk")
    parser.set_defaults(run=module.run)
    return parser
