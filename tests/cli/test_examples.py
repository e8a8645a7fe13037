"""Every command line that the README and the `--help` texts show is one that the program takes."""

import importlib
import re
import shlex
from pathlib import Path

import pytest

from adaptsim_jax.cli import parse
from adaptsim_jax.commands import SUMMARIES

ROOT = Path(__file__).parents[2]


def lines(text):
    """The `adaptsim` commands in `text`, without the words of explanation behind them (two blanks or more)."""
    found = re.findall(r"^ +adaptsim (\S.*)$", text, flags=re.M)
    return [re.split(r"\s{2,}| > ", line)[0] for line in found]


def examples():
    yield from ((f"{name}.md", line) for name in ("README",) for line in lines((ROOT / f"{name}.md").read_text()))
    for name in SUMMARIES:
        module = importlib.import_module(f"adaptsim_jax.commands.{name}")
        yield from ((name, line) for line in lines(module.EXAMPLES))


@pytest.mark.parametrize("where, line", sorted(set(examples())))
def test_an_example_is_taken(where, line):
    args = parse(shlex.split(line))
    assert callable(args.run)
    command = shlex.split(line)[0]
    if command in ("train", "compare") and "--config" not in line and "--model" not in line:
        check_config(command, args)


def check_config(command, args):
    """The keys of `--set` exist, and their sizes fit together."""
    from adaptsim_jax.commands import compare, train

    if command == "compare":
        compare.config_of(args)
    else:
        train._check(train.config_of({}, args), args)


def test_there_are_examples_of_every_command():
    shown = [line.split()[0] for where, line in examples() if where == "README.md"]
    assert set(SUMMARIES) - {"demo"} <= set(shown)  # the demo is `make demo` there
    for name in SUMMARIES:
        own = [line.split()[0] for where, line in examples() if where == name]
        assert own and set(own) == {name}


def test_commands_in_documents_exist():
    for path in [*(ROOT / "docs").rglob("*.md"), ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md"]:
        for name in re.findall(r"`adaptsim ([a-z]+)", path.read_text()):
            assert name in SUMMARIES, f"{path}: adaptsim {name}"


def test_files_that_documents_name_exist():
    """Paths with a folder and a suffix; what a person would make (`out/`, `runs/`, `logs/`) is no file of ours."""
    folders = "adaptsim_jax|benchmarks|docs|experiments|tests"
    for path in [*(ROOT / "docs").glob("*.md"), ROOT / "README.md", ROOT / "CONTRIBUTING.md"]:
        for name in re.findall(rf'[`("]((?:{folders})/[\w./-]+\.(?:py|md|png))\b', path.read_text()):
            assert (ROOT / name).exists(), f"{path.name} names {name}"
