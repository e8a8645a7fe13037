"""`adaptsim train --preset`, and that a run's own config is taken as it stands."""

import pytest

from adaptsim_jax import config
from adaptsim_jax.adapt.presets import default_config, paper_pushing
from adaptsim_jax.adapt.training import TrainConfig
from adaptsim_jax.cli import parse
from adaptsim_jax.commands.train import _start_table, config_of
from adaptsim_jax.errors import BadInput


def asked(*words):
    args = parse(["train", "pushing", "--run", "r", *words])
    return config_of(_start_table(args), args)


def test_the_push_starts_from_what_compare_trains_with():
    assert asked() == default_config("pushing") and asked().task["correct"] is True


def test_a_preset_keeps_nothing_of_the_defaults():
    made = asked("--preset", "paper-pushing", "--set", "phase1.updates=7")
    assert made.task == paper_pushing().task and made.phase1.updates == 7 and made.hyper == paper_pushing().hyper


def test_a_run_is_gone_on_with_as_it_was_even_if_the_defaults_differ():
    table = config.to_table(TrainConfig(seed=3, task={"trials": 500}))
    args = parse(["train", "pushing", "--run", "r", "--resume"])
    assert config_of(table, args) == TrainConfig(seed=3, task={"trials": 500})


def test_a_config_file_with_some_keys_is_filled_up():
    args = parse(["train", "pushing", "--run", "r"])
    made = config_of({"task": {"trials": 500}}, args)
    assert made.task == default_config("pushing").task | {"trials": 500}


@pytest.mark.parametrize(
    ("task", "name", "there"),
    [("pushing", "paper", "paper-pushing"), ("scooping", "paper-pushing", "none of scooping's")],
)
def test_an_unknown_preset_is_refused(task, name, there):
    args = parse(["train", task, "--run", "r", "--preset", name])
    with pytest.raises(BadInput, match=f"--preset: '{name}' is unknown; there is {there}"):
        _start_table(args)
