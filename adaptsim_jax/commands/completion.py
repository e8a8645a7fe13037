"""`adaptsim completion`: a script that completes commands, options and tasks in a shell."""

from __future__ import annotations

import argparse
from typing import Any

from adaptsim_jax.commands.parser import TASKS

FILES = ("DATA", "DIR", "FILE", "MODEL", "RUN", "RUN|FILE", "SPEC.toml | show DIR")
"""What the help calls an argument that is a file or a folder."""
EXAMPLES = """
  adaptsim completion bash > ~/.local/share/bash-completion/completions/adaptsim
  adaptsim completion zsh > ~/.zfunc/_adaptsim          with fpath+=~/.zfunc before compinit in ~/.zshrc
  adaptsim completion fish > ~/.config/fish/completions/adaptsim.fish
"""  # noqa: E501


def run(args: argparse.Namespace) -> int:
    """Print the script of one shell; it is made from the parsers, and does not start Python when it
    completes.
    """
    import shtab

    from adaptsim_jax.commands.parser import whole_parser

    parser = whole_parser()
    commands = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
    for command in commands[0].choices.values():
        for action in command._actions:
            _declare_words(action, shtab.FILE)
    print(shtab.complete(parser, args.shell))
    return 0


def _declare_words(action: Any, files: dict) -> None:
    """What an argument of the command line may be: one of some words, or a file (shtab reads
    `complete`, which `argparse.Action` does not declare).
    """
    if action.metavar == "TASK" and not action.option_strings:
        action.choices = list(TASKS)
    elif action.choices:
        action.choices = list(action.choices)  # shtab takes a table of words for subcommands
    elif action.metavar in FILES:
        action.complete = files
