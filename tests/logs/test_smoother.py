"""The smoother of the starts of undeclared masses, and its estimate of noise."""

import numpy as np
import pytest

from adaptsim_jax.logs.smoother import estimate, fit_noise, make_prior, posterior, smoothed


def test_the_smoother_equals_a_dense_least_squares_solution():
    rng = np.random.default_rng(1)
    time = np.cumsum(rng.uniform(0.5, 2.0, 40))
    y = np.sin(time / 6) + 0.1 * rng.standard_normal(40)
    prior = make_prior(time, 3)
    mean, _, _ = posterior(prior, 1e-2, [np.ones(40), None, None], [y, None, None])
    dense = np.zeros((120, 120))
    for k in range(6):
        for col in range(120 - k):
            dense[col + k, col] = dense[col, col + k] = prior.bands[k, col]
    # A quadratic in time costs the white-jerk prior nothing.
    s = (time - time[0]) / prior.step
    free = np.stack([s**2 / 2, s, np.ones(40)], axis=1).reshape(-1)
    assert abs(free @ dense @ free) < 1e-6 * np.abs(dense).max()
    pick = np.zeros((40, 120))
    pick[np.arange(40), 3 * np.arange(40)] = 1.0
    expected = np.linalg.solve(dense / 1e-2 + pick.T @ pick, pick.T @ y).reshape(40, 3)
    np.testing.assert_allclose(mean, expected, rtol=1e-6, atol=1e-9)


def test_the_likelihood_finds_the_walk_that_made_the_data():
    rng = np.random.default_rng(2)
    jerk = rng.standard_normal(3000) * 0.02
    signal = np.cumsum(np.cumsum(np.cumsum(jerk)))
    fits = [
        fit_noise(np.arange(300.0), c + 0.5 * rng.standard_normal(300), 3)
        for c in signal.reshape(10, 300)
    ]
    assert np.median([f.std for f in fits]) == pytest.approx(0.5, rel=0.05)
    assert np.median([f.log_ratio for f in fits]) == pytest.approx(
        np.log((0.02 / 0.5) ** 2), abs=0.7
    )


def test_noise_is_estimated_and_smoothed_away():
    rng, time = np.random.default_rng(0), np.arange(800) / 200
    motion = np.stack([np.sin(3 * time), np.cos(5 * time)], 1)
    speed = np.stack([3 * np.cos(3 * time), -5 * np.sin(5 * time)], 1)
    q = motion + 1e-3 * rng.standard_normal(motion.shape)
    v = speed + 0.03 * rng.standard_normal(motion.shape)
    found = np.array([[estimate(time, x)[0] for x in z.T] for z in (q, v)])
    np.testing.assert_allclose(found, [[1e-3] * 2, [0.03] * 2], rtol=0.15)
    smooth_q, smooth_v = smoothed(time, q, v, found)
    assert np.sqrt(np.mean((smooth_q - motion) ** 2)) < 0.5e-3
    blind = smoothed(time, q, None, found)[1]
    assert np.mean((smooth_v - speed) ** 2) < np.mean((blind - speed) ** 2)
    late = np.stack([np.interp(time - 0.03, time, x) for x in v.T], 1)
    np.testing.assert_array_equal(
        smoothed(time, q, late, found), smoothed(time, q, None, found)
    )  # a speed that lags is not used


def test_a_constant_signal_has_no_noise():
    assert estimate(np.arange(100.0), np.full(100, 3.0))[0] == 0.0
