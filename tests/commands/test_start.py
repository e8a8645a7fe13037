"""How fast the command answers, and that it answers before JAX is loaded."""

import json
import os
import resource
import subprocess
import sys

import pytest

from adaptsim_jax.cli import main, parse
from adaptsim_jax.commands import SUMMARIES

CODE = "import sys; from adaptsim_jax.cli import main; code = main(sys.argv[1:]); "
LOADED = (
    "print(code, sorted({'jax', 'numpy', 'scipy', 'mujoco', 'matplotlib', 'rich'} & "
    "set(sys.modules)))"
)


def python(*arguments, **env):
    command = [sys.executable, "-c", CODE + LOADED, *arguments]
    return subprocess.run(
        command, capture_output=True, text=True, env={**os.environ, **env}, check=True
    )


@pytest.mark.parametrize("command", [[], *([name] for name in SUMMARIES)])
def test_help_loads_no_jax(command):
    out = python(*command, "--help").stdout.splitlines()
    assert out[-1] == "0 []"
    assert out[0].startswith(" ".join(["usage: adaptsim", *command]))
    assert not command or any(line == "examples:" for line in out)


def test_help_takes_less_than_a_second_of_the_processor():
    """The best of three; its own time, not that of what runs beside it."""
    times = []
    for _ in range(3):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(
            [sys.executable, "-m", "adaptsim_jax.cli", "--help"], capture_output=True, check=True
        )
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        times.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    assert min(times) < 1.0


@pytest.mark.parametrize(
    "arguments", [["trian"], ["train", "--sed", "3"], ["adapt"], ["effects", "pushin"]]
)
def test_bad_words_are_refused_without_jax(arguments):
    out = python(*arguments)
    assert out.stdout == "2 []\n"
    assert out.stderr.startswith("adaptsim: ") and out.stderr.count("\n") == 1


def test_every_command_takes_a_seed():
    least = {
        "train": ["pendulum", "--run", "r"],
        "adapt": ["r", "--target", "wd"],
        "compare": ["pendulum", "--out", "o"],
        "close": ["logs", "env.toml", "--out", "o"],
        "init": ["d"],
        "diagnose": ["d", "--out", "o"],
        "robot": ["next", "--dir", "d"],
        "parity": ["pendulum"],
        "replay": ["m", "d"],
        "excite": ["m"],
        "export": ["o", "--as", "json"],
        "sweep": ["show", "d"],
        "new": ["effect", "e"],
        "completion": ["bash"],
    }
    for name in SUMMARIES:
        args = parse([name, *least.get(name, []), "--seed", "7"])
        assert args.seed == 7 and callable(args.run)


@pytest.mark.parametrize("task", ["pendulum", "mechanism", "pushing", "scooping", "toss"])
def test_every_catalogue_is_listed(task, capsys):
    assert main(["effects", task]) == 0
    told = capsys.readouterr().out
    assert main(["effects", task, "--json"]) == 0
    for effect in json.loads(capsys.readouterr().out):
        assert f"{effect['name']}: " in told and effect["excitation"] in told
