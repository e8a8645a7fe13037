"""Tests of the tests: levels, families, errors of the jackknife."""

import numpy as np
import pytest

from adaptsim_jax.diagnosis.testing import attainable, holm, jackknife, paired_test, share


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


def test_a_paired_test_averages_over_folds_and_blocks():
    before = np.array([1.0, 1.0, 2.0, 2.0, 1.0, 1.0])
    fold, block = np.repeat([0, 1, 2], 2), np.repeat([0, 1], 3)
    test = paired_test(before, 0.5 * before, fold, block)
    assert (test.folds, test.better, test.parts, test.p) == (3, 3, 2, 0.25)
    assert test.gain == pytest.approx(0.45, abs=0.03)
    assert paired_test(before, before).gain == pytest.approx(share(np.zeros(1)))
