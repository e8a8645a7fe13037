"""Every row of a comparison over many steps, tried on a mass on a rail whose policy takes seconds
to train.
"""

from dataclasses import replace
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from adaptsim_jax.adaptation.phase1_config import Phase1Config
from adaptsim_jax.baselines import compare_steps, steps_trained
from adaptsim_jax.baselines.arena import MethodRun
from adaptsim_jax.baselines.compare import wanted
from adaptsim_jax.baselines.compare_steps import StepsComparison, deployed_by
from adaptsim_jax.baselines.config import default_comparison
from adaptsim_jax.baselines.registry import STEPS
from adaptsim_jax.baselines.steps_arena import StepsArena
from adaptsim_jax.core import config as configs
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.environments import policies
from adaptsim_jax.environments.setting import EnvironmentConfig, setting_of
from adaptsim_jax.environments.task import task_of
from adaptsim_jax.environments.trainer import PPOTraining
from tests.environments.cart import Cart

PHASE1 = Phase1Config(
    trajectories=4, parallel=2, horizon=2, updates=2, capacity=8, archive=8, hidden=(8,)
)
SIZES = {
    "iterations": 2,
    "starts": 1,
    "sysid": {"simulations": 20, "first_fit": {"updates": 50}, "next_fit": {"updates": 50}},
    "bayesopt": {"initial": 2},
    "steps": {"points": 4, "tests": 2, "share": 0.25},
}


@pytest.fixture(scope="module")
def made():
    training = PPOTraining(steps=32 * 25 * 24, parallel=32, unroll=25, hidden=(8,))
    targets = {"heavy": {"params.mass": 2.5}, "weak": {"params.push": 2.0, "delay": 0.04}}
    setting = setting_of(
        Cart(), EnvironmentConfig(training=training, targets=targets, references=2, components=4)
    )
    task = task_of(setting)
    return setting, task.preparation.make(jax.random.key(0))


@pytest.mark.slow
@pytest.mark.parametrize(
    "method",
    [
        pytest.param(m, marks=pytest.mark.filterwarnings("ignore") if m == "sbi" else ())
        for m in STEPS
    ],
)
def test_a_method_deploys_something_in_every_target(method, made):
    if method in ("cma_es", "sbi"):
        pytest.importorskip({"cma_es": "cma"}.get(method, method), reason="it is an extra")
    setting, prepared = made
    base = default_comparison("environment")
    table = configs.over(
        configs.to_table(base), SIZES | {"train": {"phase1": configs.to_table(PHASE1)}}
    )
    config = configs.from_table(type(base), table, "test")
    said = []
    arena = StepsComparison(setting, list(setting.targets), config).arena(prepared, 0)
    run = MethodRun(config, arena, np.array([0]), lambda *told: said.append(told))
    trials, returns = deployed_by(method, run)
    assert returns.shape == (2, len(trials)) and np.isfinite(returns).all() and said
    assert (returns >= 0.0).all() and (returns <= 25.0).all()  # a step is worth 1 at most
    counted = {
        "adaptsim": [1, 2, 3],
        "bayesopt": [1, 2, 3],
        "cma_es": [1, 2, 3],
        "sysid_bayes": [0, 1, 2],
        "sysid_point": [0, 1, 2],
        "sbi": [0, 1, 2],
        "gradient": [1, 2, 3],
        "fine_tune": [0, 2],
    }
    assert list(trials) == counted.get(method, [0])


def test_what_one_seed_compiled_serves_the_next_with_its_own_policy():
    setting = setting_of(Cart(), EnvironmentConfig(targets={"heavy": {"params.mass": 2.5}}))
    programs, traced, obs = {}, [], np.array([0.3, -0.2], np.float32)

    def act(task, obs):
        traced.append(True)
        return task.act(task.init_policy(jax.random.key(0)), obs)

    found = []
    for seed in range(2):
        prepared = task_of(setting).preparation.blank(jax.random.key(seed))
        arena = StepsArena(setting, prepared, ["heavy"], 2, seed, programs)
        found.append(arena.program("act", act)(obs))
        np.testing.assert_allclose(found[seed], act(arena.one.task, obs), rtol=1e-5)
    assert (
        len(traced) == 3 and abs(found[0] - found[1]).max() > 1e-4
    )  # once compiled, twice called by hand


def test_a_policy_told_nothing_is_trained_with_the_luck_of_the_one_that_knows_e(monkeypatch):
    class Enough(Exception): ...

    def begun(trainer, key, learned, *rest, **options):
        seen.append((jax.random.key_data(key), learned.weights))
        raise Enough

    setting, seen = setting_of(Cart(), EnvironmentConfig()), []
    bout = MethodRun(None, SimpleNamespace(setting=setting, targets=[None]), np.array([3]))  # type: ignore[arg-type]
    for where, train in (
        (policies, lambda: task_of(setting).preparation.make(jax.random.key(3))),  # type: ignore[union-attr]
        (steps_trained, lambda: steps_trained.udr(bout)),
    ):
        monkeypatch.setattr(where, "trained_in", begun)
        with pytest.raises(Enough):
            train()
    (key, weights), (other_key, other_weights) = seen
    np.testing.assert_array_equal(key, other_key)
    np.testing.assert_array_equal(weights, other_weights)


def test_rows_that_cannot_be_run_are_told_before_anything_is_trained(monkeypatch, capsys):
    monkeypatch.setattr(compare_steps.importlib.util, "find_spec", lambda name: None)
    setting, base = (
        setting_of(Cart(), EnvironmentConfig(policy="tuned")),
        default_comparison("environment"),
    )
    every = StepsComparison(setting, [], base)
    assert set(compare_steps.steps_methods()) - set(wanted(every)) == {
        "cma_es",
        "sbi",
        "gradient",
    }
    told = capsys.readouterr().err.splitlines()
    assert (
        len(told) == 3
        and "compare: no row 'cma_es': it needs the package cma (pip install cma)" in told
    )
    with pytest.raises(
        BadInput, match="method 'gradient' is for policy = \"knows\"; leave it out of --methods"
    ):
        wanted(StepsComparison(setting, [], replace(base, methods=("gradient",))))
