"""Tests of the tests: levels, families, errors of the jackknife."""

import numpy as np
import pytest

from adaptsim_jax.diagnosis.report import Errors, error_rows, interval_units
from adaptsim_jax.diagnosis.testing import (
    attainable,
    deviates,
    holm,
    jackknife,
    paired_test,
    share,
)


def test_holms_step_down_stops_at_the_first_that_fails():
    assert list(holm([0.001, 0.02, 0.03], 0.06, 20)) == [0.02, 0.03, 0.06]
    assert list(holm([0.03, 0.04], 0.05, 20)) == [0.0, 0.0]  # 0.04 alone would hold
    assert list(holm([0.04, 0.01, 0.035], 0.06, 20)) == [0.0, 0.02, 0.0]


def test_a_level_is_never_below_what_so_few_blocks_can_show():
    assert attainable(0.05, 20, 2) == 0.025
    assert attainable(0.05, 4) > 2.0**-4
    assert holm([2.0**-4], 0.05, 4)[0] > 2.0**-4


def test_the_jackknife_of_a_mean_is_its_standard_error():
    z = np.random.default_rng(0).normal(size=(30, 2))
    less = np.array([np.delete(z, k, 0).mean(0) for k in range(30)])
    np.testing.assert_allclose(jackknife(less), z.std(0, ddof=1) / np.sqrt(30))


@pytest.mark.parametrize("folds", [5, 6, 8])
def test_ninety_percent_intervals_of_few_folds_cover_as_often(folds):
    rng, covered, worlds = np.random.default_rng(folds), 0, 2000
    for _ in range(worlds):
        x = rng.normal(size=(folds, 20))
        y = x + rng.normal(size=(folds, 20)) + x * rng.normal(size=(folds, 1))  # slopes of trials
        square, product = np.square(x).sum(1), (x * y).sum(1)
        less = (product.sum() - product) / (square.sum() - square)
        off = product.sum() / square.sum() - 1.0
        covered += abs(off) <= deviates(folds) * float(jackknife(less))
    assert 0.88 <= covered / worlds <= 0.93


@pytest.mark.parametrize("trials", [3, 5, 8, 24])
def test_the_interval_of_an_error_over_trials_covers_the_median(trials):
    rng, covered, worlds = np.random.default_rng(trials), 0, 400
    trial, names = np.repeat(np.arange(trials), 24), [f"t{k}" for k in range(trials)]
    for _ in range(worlds):
        logs = np.sqrt(0.3) * rng.normal(size=trials)[trial]
        error = np.exp(0.8 * (logs + np.sqrt(0.7) * rng.normal(size=len(trial))))
        table = error_rows("", "", names, Errors("1", 1.0, {"before": error}), {}, trial)
        low, high = table["intervals"]["before"]
        assert low <= table["before"] <= high
        covered += low <= 1.0 <= high
    assert 0.925 <= covered / worlds <= 0.98  # of 95 %; four standard errors of 400 worlds wide
    assert table["intervals_over"] == f"{trials} trials"


def test_an_interval_says_what_it_is_over():
    part, trial = np.arange(16) // 2, np.arange(16) // 8
    assert interval_units(part, trial)[0] == "8 parts of 2 trials"
    assert interval_units(part[:8], trial[:8])[0] == "4 parts of one trial"
    assert interval_units(part, part)[0] == "8 trials"
    lone = error_rows("", "", ["one"], Errors("1", 1.0, {"before": np.ones(1)}), {})
    assert lone["intervals"]["before"] is None
    np.testing.assert_array_equal(interval_units(part, np.arange(16) // 4)[1], np.arange(16) // 4)


def test_a_paired_test_averages_over_folds_and_blocks():
    before = np.array([1.0, 1.0, 2.0, 2.0, 1.0, 1.0])
    fold, block = np.repeat([0, 1, 2], 2), np.repeat([0, 1], 3)
    test = paired_test(before, 0.5 * before, fold, block)
    assert (test.folds, test.better, test.parts, test.p) == (3, 3, 2, 0.25)
    assert test.gain == pytest.approx(0.45, abs=0.03)
    assert paired_test(before, before).gain == pytest.approx(share(np.zeros(1)))
