"""What the tour says to type asks for what the tour did."""

import shlex
from dataclasses import replace
from pathlib import Path

import pytest

from adaptsim_jax.baselines.config import CompareConfig
from adaptsim_jax.cli import parse
from adaptsim_jax.commands import compare as compare_command
from adaptsim_jax.commands import train as train_command
from adaptsim_jax.commands.demo_config import FULL, HINGE, PENDULUM, SHORT, commands
from adaptsim_jax.commands.parser import task_word
from tests.commands.test_demo import SIZES


@pytest.mark.parametrize("sizes", [SHORT, FULL, SIZES])
def test_its_commands_ask_for_the_same(tmp_path, sizes):
    args = {k: parse(shlex.split(line)[1:]) for k, line in commands(tmp_path, 5, sizes).items()}
    assert train_command.config_of({}, args["train"]) == replace(sizes.train, seed=5)
    assert args["adapt"].folder == args["train"].folder and args["adapt"].target == "ood-1"
    assert (args["adapt"].starts, args["adapt"].iterations, args["adapt"].seed) == (
        sizes.starts,
        sizes.iterations,
        5,
    )
    task_word(args["compare"])
    asked = compare_command.config_of(args["compare"])
    wanted = {
        name: getattr(sizes, name) for name in ("seeds", "starts", "iterations", "train", "sysid")
    }
    assert asked == CompareConfig(("adaptsim", *sizes.baselines), ("ood-1",), seed=5, **wanted)
    for task, sized in (("pushing", sizes.push), ("scooping", sizes.scoop)):
        train, adapt = args[f"train_{task}"], args[f"adapt_{task}"]
        assert train_command.config_of({}, train) == sized.train(task, 5)
        assert adapt.folder == train.folder and (adapt.target, adapt.seed) == (sized.target, 5)
        assert (adapt.starts, adapt.iterations) == (sized.starts, sized.iterations)
    for name, data in (("diagnose", HINGE), ("double", PENDULUM)):
        assert (
            args[name].data == [str(data)]
            and (data / "meta.toml").exists()
            and args[name].seed == 5
        )
    for name in ("train", "train_pushing", "train_scooping", "compare", "diagnose", "double"):
        folder = Path(getattr(args[name], "folder", None) or args[name].out)
        assert tmp_path / "runs" not in folder.parents and folder.is_relative_to(tmp_path / "again")
