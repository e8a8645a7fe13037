"""Trials that were not made by one machine are told of, by kind and name; trials of one machine are
not doubted.
"""

import numpy as np
import pytest

from adaptsim_jax.logs.pendulum import read_pendulum
from adaptsim_jax.logs.quality.pendulum_design import WORDS, pendulum_trials
from adaptsim_jax.logs.quality.trial_words import add_trials, confirmed, headline, sentences
from tests.logs.arm_files import arm, write

COUNT = 8


def differ_of(tmp_path, trials):
    return pendulum_trials(read_pendulum(write(tmp_path, trials)))


def tripped(c, at=1.0):
    """The drives stop at `at` s, the log of their torques does not."""
    other = arm(count=1, seed=77)[0]
    return {
        k: x if k.startswith(("time", "tau")) else np.where(c["time"] < at, x, other[k])
        for k, x in c.items()
    }


@pytest.mark.parametrize("seed", range(6))
def test_trials_of_one_machine_are_not_doubted(tmp_path, seed):
    found = differ_of(tmp_path, arm(count=COUNT, seed=seed))
    assert found is not None and not found.differs


@pytest.mark.parametrize("size", [0.01, 0.1])
def test_zeros_that_differ_are_told_with_their_sizes(tmp_path, size):
    trials = arm(count=COUNT, seed=3)
    off = np.random.default_rng(4).uniform(-size, size, (COUNT, 2))
    moved = [
        c | {"q1": c["q1"] + a, "q2": c["q2"] + b} for c, (a, b) in zip(trials, off, strict=True)
    ]
    found = differ_of(tmp_path, moved)
    assert found.kind == "zero" and found.explained_share > 0.8
    np.testing.assert_allclose(found.size[:, 0], off[:, 0] - np.median(off[:, 0]), atol=0.4 * size)
    (line,) = sentences(found, WORDS)
    assert "zeros of the angles differ from trial to trial" in line and "degrees) in q1" in line


def test_a_trial_apart_is_named_and_offered_to_be_left_out(tmp_path):
    trials = arm(count=COUNT, seed=5)
    trials[3] = tripped(trials[3])
    weak = trials[6]
    trials[6] = weak | {
        "tau1": weak["tau1"] * 2.0,
        "tau2": weak["tau2"] * 2.0,
    }  # half of what was logged did act
    found = differ_of(tmp_path, trials)
    assert [o.trial for o in found.outliers] == ["03", "06"] and found.kind == ""
    assert (
        "nothing simple explains it" in sentences(found, WORDS)[0]
        and "--without 03" in sentences(found, WORDS)[0]
    )
    assert "torques' scale" in sentences(found, WORDS)[1]
    assert headline(found) == "03, 06 are apart from the other trials"


@pytest.mark.parametrize("own", [(2, 5), (1, 3, 5, 7)])
def test_a_load_of_some_trials_is_told_as_one(tmp_path, own):
    bare, loaded = arm(count=COUNT, seed=5), arm(count=COUNT, seed=5, tip=0.1)
    found = differ_of(tmp_path, [(loaded if k in own else bare)[k] for k in range(COUNT)])
    if len(own) == 2:
        assert [(o.trial, o.kind) for o in found.outliers] == [("02", "load"), ("05", "load")]
        assert all(0.05 < o.size[0] < 0.3 for o in found.outliers)
        return
    assert found.kind == "load" and not found.outliers
    assert np.min(found.size[1::2]) > np.max(found.size[::2])


@pytest.mark.parametrize("kind", ["degrees", "joints"])
def test_a_trial_of_other_columns_is_no_load_and_no_zero(tmp_path, kind):
    trials = arm(count=COUNT, seed=55)
    swap = {"1": "2", "2": "1"}
    trials[3] = {
        "degrees": {k: np.degrees(x) if k[0] in "qv" else x for k, x in trials[3].items()},
        "joints": {k if k == "time" else k[:-1] + swap[k[-1]]: x for k, x in trials[3].items()},
    }[kind]
    (outliers,) = differ_of(tmp_path, trials).outliers
    assert outliers.trial == "03" and outliers.kind == ""


def test_a_trial_that_spoils_the_fit_of_all_stays_odd(tmp_path):
    trials = arm(count=COUNT, seed=5)
    trials[3] = tripped(trials[3])
    found = differ_of(tmp_path, trials)
    rows = [{"trial": f"{k:02d}", "before": 0.1, "after": 0.1} for k in range(COUNT)]
    error = {"unit": "rad", "before": 0.1, "after": 0.1, "noise_floor": 2e-4, "per_trial": rows}
    assert found.outliers[0].times > 30.0 and confirmed(found, error).outliers == found.outliers
    assert not confirmed(
        found, error | {"noise_floor": 0.01}
    ).outliers  # no fit is spoilt that leaves ten times the noise


def test_what_the_mended_model_explains_is_not_told(tmp_path):
    trials = arm(count=COUNT, seed=5)
    trials[3] = tripped(trials[3])
    found = differ_of(tmp_path, trials)
    rows = [{"trial": f"{k:02d}", "before": 0.1, "after": 1e-3} for k in range(COUNT)]
    error = {"unit": "rad", "before": 0.1, "after": 1e-3, "noise_floor": 9e-4, "per_trial": rows}
    assert not confirmed(found, error).differs
    error |= {"noise_floor": 1e-4}  # much is left, though not in that trial
    assert not confirmed(found, error).outliers
    rows[3]["after"] = 0.05
    report, evidence = {"error": error, "warnings": ["first"]}, {}
    add_trials(report, evidence, found, WORDS)
    assert report["trials"]["leave_out"] == ["03"] and len(report["warnings"]) == 2
    assert [row["odd"] for row in report["trials"]["each"]] == [k == 3 for k in range(COUNT)]
    assert evidence["audit"][0]["where"] == "trials"


def test_too_few_trials_say_nothing(tmp_path):
    assert differ_of(tmp_path, arm(count=2)) is None
