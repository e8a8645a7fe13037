"""How a diagnosis was run, as its report tells it."""

import shlex
import time

import adaptsim_jax
from adaptsim_jax import cli
from adaptsim_jax.diagnosis.run import Run, command_of


def test_the_report_names_the_command_that_repeats_it():
    again = cli.parse(shlex.split(command_of("logs/my rig"))[1:])
    assert (again.data, again.seed, again.exclude, again.without, again.model) == (
        ["logs/my rig"],
        0,
        [],
        [],
        None,
    )
    given = {
        "seed": 3,
        "model": "arm.xml",
        "exclude": ["spring", "bias"],
        "without": ["02"],
        "as_declared": True,
    }
    again = cli.parse(shlex.split(command_of("logs", out="there", **given))[1:])
    assert {name: getattr(again, name) for name in given} == given
    assert (again.data, str(again.out)) == (["logs"], "there")
    assert command_of(("day 1", "day2")) == "adaptsim diagnose 'day 1' day2 --out again"


def test_a_run_tells_its_seconds_when_it_is_over():
    told = Run("adaptsim diagnose logs", time.monotonic() - 5.0, seed=2).as_dict()
    assert told["version"] == adaptsim_jax.__version__ and told["seed"] == 2
    assert told["command"] == "adaptsim diagnose logs" and 5.0 <= told["seconds"] < 6.0
