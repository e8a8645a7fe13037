"""`adaptsim completion`: a script that completes commands, options and tasks in a shell."""

from __future__ import annotations

import argparse

from adaptsim_jax.commands import SUMMARIES
from adaptsim_jax.commands.common import TASKS

SHELLS = ("bash", "zsh", "fish")
EXAMPLES = """
  adaptsim completion bash > ~/.local/share/bash-completion/completions/adaptsim
  adaptsim completion zsh > ~/.zfunc/_adaptsim          with fpath+=~/.zfunc before compinit in ~/.zshrc
  adaptsim completion fish > ~/.config/fish/completions/adaptsim.fish
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("shell", choices=SHELLS, metavar="SHELL", help="bash, zsh or fish")


def run(args: argparse.Namespace) -> int:
    """Print the script of one shell; it is made from the parsers, and does not start Python when it
    completes.
    """
    found = {name: options_of(name) for name in SUMMARIES}
    print({"bash": bash, "zsh": zsh, "fish": fish}[args.shell](found), end="")
    return 0


def options_of(name: str) -> dict[str, str]:
    """Options of a command with their help; and the words that its first argument may be, with an
    empty help.
    """
    from adaptsim_jax.commands.parser import command_parser

    found: dict[str, str] = {}
    for action in command_parser(name)._actions:
        told = (action.help or "").split(";")[0].replace("'", "").replace("%%", "%")
        found |= {option: told for option in action.option_strings if option.startswith("--")}
        if not action.option_strings and action.choices:
            found |= {str(choice): "" for choice in action.choices}
        elif not action.option_strings and action.metavar == "TASK":
            found |= {task: "" for task in TASKS}
    return found


def bash(found: dict[str, dict[str, str]]) -> str:
    """A completion function of bash; files where no word fits."""
    cases = "\n".join(
        f"    {name}) words='{' '.join(options)}' ;;" for name, options in found.items()
    )
    return f"""# completion of adaptsim for bash
_adaptsim() {{
  local word=${{COMP_WORDS[COMP_CWORD]}} words
  case ${{COMP_WORDS[1]}} in
{cases}
  esac
  if [ "$COMP_CWORD" -eq 1 ]; then words='{" ".join(found)} --help --version'; fi
  COMPREPLY=($(compgen -W "$words" -- "$word"))
  if [ ${{#COMPREPLY[@]}} -eq 0 ]; then COMPREPLY=($(compgen -f -- "$word")); fi
}}
complete -o filenames -F _adaptsim adaptsim
"""


def zsh(found: dict[str, dict[str, str]]) -> str:
    """A completion function of zsh, to be found in `fpath` as `_adaptsim`."""

    def quoted(text):
        return text.replace(":", "\\:")

    commands = "\n".join(f"    '{name}:{quoted(SUMMARIES[name])}'" for name in found)
    cases = []
    for name, options in found.items():
        told = "\n".join(f"        '{option}:{quoted(words)}'" for option, words in options.items())
        cases.append(f"    {name}) options=(\n{told}\n      ) ;;")
    body = "\n".join(cases)
    return f"""#compdef adaptsim
_adaptsim() {{
  local -a commands options
  commands=(
{commands}
  )
  if (( CURRENT == 2 )); then
    _describe 'command' commands
    return
  fi
  case ${{words[2]}} in
{body}
  esac
  _describe 'option' options
  _files
}}
compdef _adaptsim adaptsim
"""


def fish(found: dict[str, dict[str, str]]) -> str:
    """Lines of `complete` for fish."""
    lines = ["# completion of adaptsim for fish"]
    for name, options in found.items():
        lines.append(
            f"complete -c adaptsim -n __fish_use_subcommand -f -a {name} -d '{SUMMARIES[name]}'"
        )
        for option, words in options.items():
            if option.startswith("--"):
                what = f"-l {option.removeprefix('--')} -d '{words}'"
            else:
                what = f"-a {option}"
            lines.append(f"complete -c adaptsim -n '__fish_seen_subcommand_from {name}' {what}")
    return "\n".join(lines) + "\n"
