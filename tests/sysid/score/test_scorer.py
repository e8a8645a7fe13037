"""Scores: calibrated under no effect, strong under one, blind to what the declared parameters can do."""

import numpy as np
from scipy.stats import kstest

from adaptsim_jax.logs.segments import folds
from adaptsim_jax.sysid.estimate import variance
from adaptsim_jax.sysid.score import scorer as score
from tests.sysid.linear_world import make

COULOMB = score.Atom("coulomb", "joint1", {}, (0,), sign=1)
WAVE = score.Atom("wave", "joint1", {}, (1,))


def scorer(lin):
    white = variance.whiten(lin, variance.whitener(lin, variance.estimate(lin)))
    return score.Scorer(white, folds(white.trial, white.rows))


def test_p_values_are_uniform_without_effect():
    p = [scorer(make(np.random.default_rng(100 + s), force_std=0.2)).score([COULOMB]).p_value for s in range(60)]
    assert kstest(p, "uniform").pvalue > 1e-3
    assert np.mean(np.array(p) < 0.05) <= 0.15


def test_an_effect_is_found_and_sized():
    found = scorer(make(np.random.default_rng(7), force_std=0.1, effect=0.2)).score([COULOMB])
    assert found.p_value < 1e-6
    assert found.held_out_gain > 0
    assert abs(found.amplitude[0] - 0.2) < 3 * found.amplitude[0] / np.sqrt(found.gain)


def test_the_wrong_candidate_gains_nothing_on_held_out_data():
    s = scorer(make(np.random.default_rng(8), effect=0.2))
    assert s.score([WAVE]).held_out_gain < 0.05 * s.score([COULOMB]).held_out_gain


def test_a_copy_of_a_declared_column_is_confounded():
    lin = make(np.random.default_rng(9), effect=0.2)
    twin = variance.Linearised(**{**lin.__dict__, "atoms": np.concatenate([lin.atoms, lin.jac_theta[..., :1]], -1)})
    s = scorer(twin)
    assert s.score([score.Atom("twin", "joint1", {}, (2,))]).retained < 1e-6
    assert s.score([COULOMB]).retained > 0.05


def test_duplicated_windows_do_not_change_amplitudes():
    lin = make(np.random.default_rng(10), effect=0.2)
    twice = variance.Linearised(**{k: v if k == "channel" else np.concatenate([v, v]) for k, v in lin.__dict__.items()})
    np.testing.assert_allclose(scorer(lin).gain([0])[1], scorer(twice).gain([0])[1], rtol=0.05)


def test_folds_are_trials_or_blocks():
    trial, rows = np.repeat(np.arange(4), 5), np.ones(20)
    assert len(np.unique(folds(trial, rows))) == 4
    assert len(np.unique(folds(np.zeros(20, int), rows))) == 6
