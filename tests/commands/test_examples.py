"""Every command line that the README, the pages of `docs/` and the `--help` texts show is one that
the program takes.
"""

import importlib
import re
import shlex
from pathlib import Path

import pytest

from adaptsim_jax.adaptation.training import PRESETS
from adaptsim_jax.baselines.registry import exact_methods, learned_methods
from adaptsim_jax.cli import parse
from adaptsim_jax.commands import SUMMARIES
from adaptsim_jax.commands.parser import task_word
from adaptsim_jax.tasks.pushing import engines as pushing
from adaptsim_jax.tasks.registry import TASKS
from adaptsim_jax.tasks.scooping import engines as scooping

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "SKILL.md", *sorted((ROOT / "docs").rglob("*.md"))]


def lines(text):
    """The `adaptsim` commands in `text`, on lines that are indented or begin with `$`; without the
    words of explanation behind them (two blanks or more).
    """
    whole = re.sub(r" *\\\n *", " ", text)
    found = re.findall(r"^(?: +|\$ )adaptsim (\S.*)$", whole, flags=re.M)
    return [re.split(r"\s{2,}| > ", line)[0] for line in found]


def examples():
    for path in PAGES:
        yield from ((path.name, line) for line in lines(path.read_text()))
    for name in SUMMARIES:
        module = importlib.import_module(f"adaptsim_jax.commands.{name}")
        yield from ((name, line) for line in lines(module.EXAMPLES))


@pytest.mark.parametrize("line, where", sorted({line: where for where, line in examples()}.items()))
def test_an_example_is_taken(line, where, monkeypatch):
    args = parse(shlex.split(line))
    assert callable(args.run)
    command = shlex.split(line)[0]
    if command == "train" and args.model:
        assert TASKS[args.task].of_model, "refused for this task"
    if command in ("train", "compare") and "--config" not in line and "--model" not in line:
        if args.task.endswith(".toml") and not (ROOT / args.task).exists():
            return  # a file that the reader has just made
        monkeypatch.chdir(ROOT)
        args.task = task_word(args)
        check_config(command, args)


def check_config(command, args):
    """The keys of `--set` exist, and their sizes fit together."""
    from adaptsim_jax.commands import compare, train

    if command == "compare":
        compare.config_of(args)
    else:
        train._check(train.config_of(train._start_table(args), args), args)


def test_there_are_examples_of_every_command():
    readme = (ROOT / "README.md").read_text()
    shown = {line.split()[0] for line in lines(readme)} | set(
        re.findall(r"`adaptsim ([a-z]+)`", readme)
    )
    assert set(SUMMARIES) - {"demo"} <= shown  # the demo is `make demo` there
    for name in SUMMARIES:
        own = [line.split()[0] for where, line in examples() if where == name]
        assert own and set(own) == {name}


def test_commands_of_several_lines_and_of_sessions_are_found():
    text = (
        "    adaptsim train pendulum --run a \\\n      --seed 3     as it was\n\n$ adaptsim robot "
        "next\nadaptsim: no\n"
    )
    assert lines(text) == ["train pendulum --run a --seed 3", "robot next"]


def test_presets_that_documents_name_exist_and_are_no_files():
    for path in PAGES:
        for option, name in re.findall(r"--(preset|config) ([\w./-]+)", path.read_text()):
            assert (name in PRESETS) == (option == "preset"), f"{path.name}: --{option} {name}"


def test_commands_in_documents_exist():
    for path in [*PAGES, ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md"]:
        for name in re.findall(r"`adaptsim ([a-z]+)", path.read_text()):
            assert name in SUMMARIES, f"{path}: adaptsim {name}"


def test_files_that_documents_name_exist():
    """Paths with a folder and a suffix; what a person would make (`out/`, `runs/`, `logs/`) is no
    file of ours.
    """
    folders = "adaptsim_jax|benchmarks|docs|experiments|tests"
    for path in [*PAGES, ROOT / "CONTRIBUTING.md"]:
        for name in re.findall(
            rf'[`("]((?:{folders})/[\w./-]+\.(?:py|md|png))\b', path.read_text()
        ):
            assert (ROOT / name).exists(), f"{path.name} names {name}"


@pytest.fixture
def help_of(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "2000")  # argparse breaks lines also within a name

    def text(command):
        with pytest.raises(SystemExit):
            parse([command, "--help"])
        return capsys.readouterr().out

    return text


def test_help_names_every_preset(help_of):
    shown = help_of("train")
    assert all(name in shown for name in PRESETS)


def test_help_names_every_method_and_engine_of_each_task(help_of):
    """The lists stand in the command as text, because its module must not import JAX."""
    shown = help_of("compare")

    def spelled(names):
        return ", ".join(name.replace("_", "-") for name in names)

    assert f"pendulum: {spelled(exact_methods())};" in shown
    assert f"pushing and scooping: {spelled(learned_methods())}" in shown
    for task, engines in (("pushing", pushing.BACKENDS), ("scooping", scooping.BACKENDS)):
        listed = re.search(rf"{task}: ([a-z, ]+ or [a-z]+)", shown)
        assert listed and set(re.split(", | or ", listed[1])) == set(engines)
