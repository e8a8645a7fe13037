"""What a comparison of policies over many steps makes of what methods did: deployed by their own
trials, normalised, written.
"""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from adaptsim_jax.baselines.arena import Visits
from adaptsim_jax.baselines.compare import stamped
from adaptsim_jax.baselines.compare_steps import Deployed, bounds_of, deployed_of, rows_of
from adaptsim_jax.baselines.config import default_comparison
from adaptsim_jax.report import figures as look
from adaptsim_jax.report.comparison import write_comparison


def arena(own, trials=1) -> Any:
    return cast(Any, SimpleNamespace(own=own, one=SimpleNamespace(trials=trials)))


def test_what_returned_most_in_its_own_trials_is_deployed_not_what_tests_best():
    own = [
        np.array([1.0, 5.0]),
        np.array([3.0, np.nan]),
        np.array([2.0, 6.0]),
    ]  # a visit each, of two targets
    tests = np.array([[10.0, 20.0, 90.0], [1.0, 2.0, 3.0]])[:, None, None]
    found = deployed_of("bayesopt", Visits(None, np.arange(1, 4), tests), arena(own))
    assert found.trials.tolist() == [1, 2, 3]
    assert found.returns.tolist() == [[10.0, 20.0, 20.0], [1.0, 1.0, 3.0]]
    assert found.at(2).tolist() == [20.0, 1.0] and np.isnan(found.at(0)).all()


def test_starts_that_go_side_by_side_count_each_their_trials():
    own = [
        np.array([1.0, 4.0]),
        np.array([5.0, 2.0]),
    ]  # one target, two starts, two visits of two episodes each
    tests = np.array([[[1.0, 3.0], [2.0, 4.0]]])[:, None]  # [T, S, N, I]
    found = deployed_of("adaptsim", Visits(None, np.array([4, 8]), tests), arena(own, trials=2))
    assert found.trials.tolist() == [2, 4, 6, 8]
    assert found.returns.tolist() == [[1.0, 2.0, 3.0, 3.0]]


def test_sysid_deploys_the_newest_after_the_trials_before_it():
    found = deployed_of(
        "sysid_point", Visits(None, np.arange(1, 4), np.array([[[[1.0, 2.0, 3.0]]]])), arena([])
    )
    assert found.trials.tolist() == [0, 1, 2] and found.returns.tolist() == [[1.0, 2.0, 3.0]]


def whole(rng):
    def once(low, high):
        return [Deployed(np.zeros(1, int), rng.uniform(low, high, (2, 1))) for _ in range(3)]

    rising = [
        Deployed(np.arange(1, 5), np.sort(rng.uniform(50.0, 100.0, (2, 4)), 1)) for _ in range(3)
    ]
    return {"udr": once(50.0, 60.0), "oracle": once(100.0, 110.0), "adaptsim": rising}


def test_returns_are_normalised_between_udr_and_the_oracle_and_written(tmp_path):
    found = whole(np.random.default_rng(0))
    lower, upper = bounds_of(found)
    rows = {
        (r["method"], r["setting"]): r for m in found for r in rows_of(m, found, ["dry", "late"])
    }
    assert rows["udr", "dry"]["mean"] == pytest.approx(0.0, abs=1e-9)
    assert rows["oracle", "late"]["mean"] == pytest.approx(1.0)
    ours = rows["adaptsim", "late"]
    last = np.mean([d.returns[1, -1] for d in found["adaptsim"]])
    assert ours["mean"] == pytest.approx((last - lower[1]) / (upper[1] - lower[1]))
    assert ours["target_trials"] == 4 and rows["oracle", "dry"]["target_trials"] is None
    assert ours["at"]["0"] is None and ours["at"]["40"]["mean"] == pytest.approx(ours["mean"])
    assert ours["at"]["2"]["low"] <= ours["at"]["2"]["mean"] <= ours["at"]["2"]["high"]
    config = default_comparison("environment")
    about = {
        "simulator": "s",
        "target_backend": "mujoco",
        "trials_axis": True,
        "reward": "return",
        "oracle": "o",
    }
    settings = {n: {"params": {}, "udr_return": 1.0, "best_return": 2.0} for n in ("dry", "late")}
    results = (
        stamped("environment", config) | about | {"settings": settings, "rows": list(rows.values())}
    )
    paths = write_comparison(results, tmp_path)
    assert {p.name for p in paths} >= {
        "results.json",
        "table.md",
        "report.html",
    }
    text = (tmp_path / "table.md").read_text()
    assert (
        "late, by target trials (mean over seeds):" in text
        and "| method | 0 | 2 |" in text
        and "| AdaptSim |  | " in text
    )
    assert "The return itself, mean over seeds:" in text and "iteration [" not in text
    page = (tmp_path / "report.html").read_text()
    assert "after all target trials" in page and '"title":{"text":"target trials"}' in page.replace(
        ": ", ":"
    )
    assert look.lower_limit(results) < -0.2 and "0 UDR" in look.reward_of(
        results
    )  # what is below UDR is seen to be


def test_where_udr_is_as_good_as_the_oracle_nothing_is_blown_up():
    same = [Deployed(np.zeros(1, int), np.full((1, 1), 80.0))]
    lower, upper = bounds_of({"udr": same, "oracle": same})
    assert upper - lower == pytest.approx(0.02 * 80.0, rel=1e-3)
