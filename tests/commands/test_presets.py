"""`adaptsim train --preset`, and that a run's own config is taken as it stands."""

import pytest

from adaptsim_jax.adaptation.training import TrainConfig, default_config, preset
from adaptsim_jax.cli import parse
from adaptsim_jax.commands.train import _check, _start_table, config_of
from adaptsim_jax.core import config
from adaptsim_jax.core.errors import BadInput


def asked(*words):
    args = parse(["train", "pushing", "--run", "r", *words])
    return config_of(_start_table(args), args)


def test_the_push_starts_from_what_compare_trains_with():
    assert asked() == default_config("pushing") and asked().task["correct"] is True


def test_a_preset_keeps_nothing_of_the_defaults():
    made = asked("--preset", "paper-pushing", "--set", "phase1.updates=7")
    assert (
        made.task == preset("paper-pushing").task
        and made.phase1.updates == 7
        and made.hyper == preset("paper-pushing").hyper
    )


@pytest.mark.parametrize("key", ["training.block=300", "tuning.near=0.5", "shared.trials=64"])
def test_options_that_the_defaults_do_not_name_can_be_set(key):
    table = key.split(".", maxsplit=1)[0]
    assert table not in default_config("pushing").task
    args = parse(["train", "pushing", "--run", "r", "--set", f"task.{key}"])
    made = config_of({}, args)
    assert set(made.task) == {*default_config("pushing").task, table}
    _check(made, args)


@pytest.mark.parametrize(
    ("key", "says"),
    [
        ("task.trainng.block=3", "unknown key 'trainng'; did you mean 'training'?"),
        ("task.training.blok=3", r"unknown key 'training\.blok'; did you mean 'block'?"),
        ("task.training=3", "key 'training' is 3; a value of type GoalConfig"),
        ("phase1.reus.first=3", r"unknown key 'phase1\.reus'; did you mean 'reuse'?"),
    ],
)
def test_a_wrong_key_in_a_nested_table_is_named(key, says):
    args = parse(["train", "pushing", "--run", "r", "--set", key])
    with pytest.raises(BadInput, match=says):
        _check(config_of({}, args), args)


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
    [
        ("pushing", "paper", "paper-pushing"),
        ("scooping", "paper-pushing", "hydro-scooping or mjx-scooping"),
    ],
)
def test_an_unknown_preset_is_refused(task, name, there):
    args = parse(["train", task, "--run", "r", "--preset", name])
    with pytest.raises(BadInput, match=f"--preset: '{name}' is unknown; there is {there}"):
        _start_table(args)
