"""`env.toml` on the command line: a new environment runs as it stands; train, adapt, sweep; what is
wrong is one line.
"""

import json
import tomllib
from dataclasses import replace
from typing import Any, NamedTuple

import jax.numpy as jnp
import mujoco
import pytest

from adaptsim_jax.adaptation.sweep_read import read_sweep
from adaptsim_jax.cli import main
from adaptsim_jax.core.config import from_table
from adaptsim_jax.environments.kind import at_nominal
from adaptsim_jax.environments.peers import load
from adaptsim_jax.environments.setting import EnvironmentConfig, read_env
from adaptsim_jax.environments.task import environment_setting, task_of
from tests.commands.test_examples import ROOT

SMALL = [
    "task.training.steps=2000",
    "task.training.parallel=20",
    "task.training.unroll=20",
    "task.training.hidden=[8]",
    "task.references=2",
    "phase1.trajectories=4",
    "phase1.parallel=2",
    "phase1.horizon=2",
    "phase1.updates=2",
    "phase1.capacity=8",
    "phase1.archive=8",
    "task.length=20",
]
SETS = [word for one in SMALL for word in ("--set", one)]


class Told(NamedTuple):
    score: Any


def test_a_new_environment_is_three_files_that_fit(tmp_path, capsys):
    assert main(["new", "environment", "hopper", "--dir", str(tmp_path)]) == 0
    told = capsys.readouterr().out
    assert all(f"{tmp_path / 'hopper'}{end}" in told for end in (".toml", ".py", ".xml"))
    assert f"next: adaptsim train {tmp_path / 'hopper.toml'} --run runs/hopper" in told
    table = read_env(tmp_path / "hopper.toml")
    env = load(table["task"]["env"])
    assert isinstance(env.mj_model, mujoco.MjModel) and env.action_size == 1
    assert set(table["task"]["targets"]) == {"weak", "dry"}
    assert main(["new", "environment", "hopper", "--dir", str(tmp_path)]) == 2


@pytest.mark.slow
def test_it_trains_adapts_is_filmed_and_compared(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ADAPTSIM_CACHE", str(tmp_path / "cache"))
    assert main(["new", "environment", "hopper"]) == 0
    assert main(["train", "hopper.toml", "--run", "run", *SETS]) == 0
    assert (
        main(["adapt", "run", "--target", "dry", "--starts", "1", "--iterations", "1", "--video"])
        == 0
    )
    found = json.loads((tmp_path / "run/adapt-dry/result.json").read_text())
    assert found["trials"] == 2 and set(found["best"]["params"]) == set(
        read_env("hopper.toml")["task"]["fields"]
    )
    assert list((tmp_path / "run/adapt-dry").glob("policies.*"))
    sets = [
        w.replace("task.", "train.task.", 1).replace("phase1.", "train.phase1.", 1) for w in SETS
    ]
    # every row is tried in tests/baselines/test_steps_methods.py
    methods = "adaptsim,sysid-point,udr,oracle"
    budgets = [
        "iterations=1",
        "starts=1",
        "sysid.simulations=20",
        "bayesopt.initial=2",
        "steps.points=4",
        "steps.tests=2",
    ]
    more = [word for one in budgets for word in ("--set", one)]
    command = [
        "compare",
        "hopper.toml",
        "--out",
        "compared",
        "--seeds",
        "1",
        "--settings",
        "dry",
        "--methods",
        methods,
    ]
    assert main([*command, *sets, *more]) == 0
    rows = {
        r["method"]: r for r in json.loads((tmp_path / "compared/results.json").read_text())["rows"]
    }
    assert rows["udr"]["mean"] == 0.0 and rows["oracle"]["target_trials"] is None
    assert rows["adaptsim"]["trials"] == [1, 2] and rows["sysid_point"]["trials"] == [0, 1]
    assert "runs/hopper" not in capsys.readouterr().err


def test_what_the_file_says_is_a_line_of_the_figure():
    options = {"env": "tests.environments.cart:Cart", "length": 5}
    config = from_table(EnvironmentConfig, options, "env.toml")
    setting = environment_setting(config)
    task = replace(
        task_of(setting),
        rollout=lambda key, policy, params: Told(policy.mean @ jnp.array([10.0, 1.0])),
    )
    # nominal: 1 kg of 0.5 to 2 (log), 0.4 N s/m of 0.1 to 2
    assert at_nominal(task, config) == pytest.approx(10 * 0.5 + 0.3 / 1.9, abs=1e-4)


@pytest.mark.parametrize(
    ("text", "tells"),
    [
        ('env = "cartpoel"', "did you mean 'cartpole'?"),
        ('env = "nothing.py:make"', "no such file"),
        ('env = "no_such_module:make"', "no module 'no_such_module'"),
        ('env = "cartpole"\nfeilds = 1', "unknown key 'feilds'; did you mean 'fields'?"),
        ('env = "cartpole"\n[fields]\n"body:pol.mass" = [0.1, 0.5]', "did you mean 'body:pole'?"),
        (
            'env = "cartpole"\n[targets.dry]\n"joint:slide.frictionlos" = 1',
            "a joint has damping, frictionloss",
        ),
        ('env = "cartpole"\n[options]\ngravity = 3', "mend [options]"),
        (
            'env = "cartpole"\n[training]\nparallel = 7\nunroll = 9',
            "do not divide into 8 minibatches",
        ),
        ('env = "json:loads"', "mend [options]"),
    ],
)
def test_what_is_wrong_is_one_line_and_nothing_is_written(text, tells, tmp_path, capsys):
    (tmp_path / "env.toml").write_text(text)
    assert main(["train", str(tmp_path / "env.toml"), "--run", str(tmp_path / "run")]) == 2
    said = capsys.readouterr().err
    assert tells in said and said.count("\n") == 1 and not (tmp_path / "run").exists()


def test_a_sweep_goes_over_an_environment(tmp_path):
    (tmp_path / "env.toml").write_text(
        'env = "cartpole"\n[phase1]\nhorizon = 4\n[targets.weak]\n"body:pole.mass" = 0.7'
    )
    (tmp_path / "spec.toml").write_text(
        'task = "env.toml"\ntargets = ["weak"]\nseeds = 2\n[grid]\nhyper.delta = [0.1, 0.3]'
    )
    sweep = read_sweep(tmp_path / "spec.toml")
    assert sweep.spec.task == "environment" and len(sweep.members) == 4
    assert {m.config.phase1.horizon for m in sweep.members} == {4}
    assert {m.config.hyper.delta for m in sweep.members} == {0.1, 0.3}


@pytest.mark.parametrize("name", ["env.toml"])
def test_examples_are_read(name):
    table = read_env(ROOT / "examples" / name)
    setting = environment_setting(from_table(EnvironmentConfig, table["task"], name))
    assert set(setting.targets) == set(
        tomllib.loads((ROOT / "examples" / name).read_text())["targets"]
    )
    assert [f.name for f in setting.fields][setting.space.dim :] == [
        "joint:slide.frictionloss",
        "delay",
        "joint:slide.damping",
        "action_scale",
    ]
