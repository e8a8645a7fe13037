"""The comparison end to end on tiny budgets, and its normalisation and statistics by hand."""

import json
import math
import sys

import numpy as np
import pytest

from adaptsim_jax.adaptation.phase1 import Phase1Config
from adaptsim_jax.adaptation.training import TrainConfig
from adaptsim_jax.baselines.compare import compare, stamped
from adaptsim_jax.baselines.compare_exact import best_over
from adaptsim_jax.baselines.config import CompareConfig
from adaptsim_jax.baselines.mdn import FitConfig
from adaptsim_jax.baselines.registry import exact_methods
from adaptsim_jax.baselines.results import (
    best_and_last,
    bootstrap_interval,
    normalised,
    plain,
    row,
)
from adaptsim_jax.baselines.sysid import SysIdConfig
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.report.comparison import write_comparison

TINY = CompareConfig(
    methods=("adaptsim", "sysid_point", "udr", "best_in_omega"),
    settings=("wd", "ood-1"),
    seeds=2,
    iterations=2,
    train=TrainConfig(phase1=Phase1Config(trajectories=100, parallel=50, updates=5)),
    sysid=SysIdConfig(
        simulations=100,
        hidden=(32,),
        first_fit=FitConfig(updates=300),
        next_fit=FitConfig(updates=50),
    ),
)
SCHEMA = [
    "method",
    "setting",
    "mean",
    "median",
    "q25",
    "q75",
    "final_mean",
    "low",
    "high",
    "oracle",
    "target_trials",
]


@pytest.fixture(scope="module")
def results():
    return compare("pendulum", TINY)


def cell(results, method, setting):
    return next(r for r in results["rows"] if (r["method"], r["setting"]) == (method, setting))


@pytest.mark.slow
def test_results_keep_the_schema(results):
    for key in (
        "schema",
        "task",
        "simulator",
        "target_backend",
        "seeds",
        "command",
        "versions",
        "rows",
    ):
        assert key in results
    assert len(results["rows"]) == len(TINY.methods) * len(TINY.settings)
    for r in results["rows"]:
        assert [k for k in SCHEMA if k not in r] == []
        assert len(r["per_seed"]) == 2
        assert r["low"] <= r["mean"] <= r["high"]
    json.dumps(results, allow_nan=False)


@pytest.mark.slow
def test_bounds_are_zero_and_one_and_nothing_beats_the_best(results):
    assert cell(results, "udr", "wd")["mean"] == 0.0
    assert cell(results, "best_in_omega", "ood-1")["mean"] == 1.0
    for r in results["rows"]:
        assert max(r["per_seed"]) <= 1.0 + 1e-6


@pytest.mark.slow
def test_known_facts_of_the_pendulum(results):
    assert (
        cell(results, "sysid_point", "wd")["mean"] > 0.9
    )  # within Omega the parameters can be identified
    assert cell(results, "adaptsim", "wd")["oracle"] == 1.0
    assert (
        1.0 < cell(results, "adaptsim", "ood-1")["oracle"] < 2.0
    )  # m2 = 0.3 lies outside of Omega


@pytest.mark.slow
def test_target_rollouts_are_all_counted(results):
    assert cell(results, "adaptsim", "wd")["target_trials"] == 2 * 3
    assert cell(results, "sysid_point", "wd")["target_trials"] == 3
    assert cell(results, "udr", "wd")["target_trials"] == 0
    assert cell(results, "best_in_omega", "wd")["target_trials"] is None


@pytest.mark.slow
def test_what_compare_writes(results, tmp_path):
    paths = write_comparison(results, tmp_path / "out")
    assert json.loads(paths[0].read_text()) == json.loads(json.dumps(results))
    text = paths[1].read_text()
    assert "| AdaptSim | " in text and "OOD-1" in text and "SysID-Point 3" in text
    assert all(p.stat().st_size > 100 for p in paths)


def test_unknown_names_are_told():
    with pytest.raises(BadInput, match="did you mean 'adaptsim'"):
        CompareConfig(methods=("adaptsin",))
    with pytest.raises(BadInput, match="ood-1"):
        compare("pendulum", CompareConfig(settings=("ood1",)))


def test_normalisation_by_hand():
    out = normalised(
        np.array([[8.0, 12.0], [1.0, np.inf]]), np.array([10.0, 2.0]), np.array([6.0, 1.0])
    )
    np.testing.assert_array_equal(out, [[0.5, -0.5], [1.0, -np.inf]])


def test_best_of_the_distributions_ignores_what_failed():
    costs = np.array([[[3.0, np.nan, np.inf], [2.0, 5.0, np.nan]]])
    np.testing.assert_array_equal(best_over(costs), [[2.0, 5.0, np.inf]])


def test_best_and_last_means_by_hand():
    rewards = np.array([[[0.1, np.nan], [0.4, 0.2]], [[np.inf, -1.0], [-3.0, -2.0]]])
    means = np.arange(8.0).reshape(2, 2, 2, 1)
    best, last = best_and_last(rewards, means)
    np.testing.assert_array_equal(best, [[2.0], [5.0]])
    np.testing.assert_array_equal(last, [[1.0], [3.0], [5.0], [7.0]])


def test_row_statistics_by_hand():
    curves = np.array([[0.0, 0.5, 0.2], [0.4, 0.1, 0.3], [0.0, 0.9, 0.8], [0.2, 0.2, 0.2]])
    out = row("x", "wd", curves, oracle=None, target_trials=3)
    assert out["per_seed"] == [0.5, 0.4, 0.9, 0.2]
    assert (out["mean"], out["median"]) == (pytest.approx(0.5), pytest.approx(0.45))
    assert (out["q25"], out["q75"]) == (pytest.approx(0.35), pytest.approx(0.6))
    assert out["final_mean"] == pytest.approx(0.375)
    assert out["best_iteration_mean"] == pytest.approx(0.425)


def test_failed_seeds_are_not_averaged_away():
    out = row("x", "wd", np.array([[0.5, 0.6], [-np.inf, -np.inf]]), oracle=1.0, target_trials=1)
    assert out["mean"] is None and out["per_seed"] == [0.6, None]
    assert out["mean_clipped"] == pytest.approx(0.3)


def test_bootstrap_interval_is_that_of_the_mean():
    values = np.random.default_rng(0).normal(size=200)
    low, high = bootstrap_interval(values)
    half = 1.96 * values.std() / math.sqrt(200)
    assert (values.mean() - low, high - values.mean()) == (
        pytest.approx(half, rel=0.1),
        pytest.approx(half, rel=0.1),
    )
    assert bootstrap_interval(np.array([0.3])) == (0.3, 0.3)


def test_plain_is_json():
    assert plain({"a": np.float32(0.5), "b": (np.int64(3), np.nan), "c": np.array([[1.0]])}) == {
        "a": 0.5,
        "b": [3, None],
        "c": [[1.0]],
    }


def test_the_command_is_what_the_caller_says(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["pytest", "--token=secret"])
    assert stamped("pendulum", TINY)["command"] is None
    assert stamped("pendulum", TINY, "adaptsim compare pendulum --out 'my results'")[
        "command"
    ].endswith("'my results'")


def test_every_method_is_reachable_by_name():
    assert set(exact_methods()) == {
        *(
            "adaptsim",
            "adaptsim_state",
            "sysid_bayes",
            "sysid_bayes_state",
            "sysid_point",
            "sysid_point_state",
        ),
        *("adaptsim_analytic", "gradient", "udr", "best_in_omega"),
    }
