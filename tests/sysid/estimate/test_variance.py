"""Variance components and whitening against data whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest

from adaptsim_jax.sysid.estimate import variance
from tests.sysid.linear_world import make


@pytest.mark.parametrize("force_std", [0.05, 0.5])
def test_force_variance_is_recovered(force_std):
    lin = make(np.random.default_rng(1), force_std=force_std)
    parts = variance.estimate(lin)
    assert parts.force_std()[0] == pytest.approx(force_std, rel=0.3)
    assert parts.sensor[0] == pytest.approx(1.0, rel=0.25)


def test_white_data_show_no_force():
    parts = variance.estimate(make(np.random.default_rng(2)))
    assert parts.force_std()[0] < 0.02


def test_wrong_sensor_noise_is_noticed():
    parts = variance.estimate(make(np.random.default_rng(3), noise=2.0))
    assert parts.sensor[0] == pytest.approx(4.0, rel=0.3)


@pytest.mark.parametrize(("hertz", "size"), [(8.0, 5.0), (8.0, 30.0), (11.0, 30.0), (11.0, 100.0)])
def test_a_hum_is_a_force_and_not_a_worse_sensor(hertz, size):
    """Of a tilt beside a hum the hum was dropped, nine thousand units of likelihood behind: the sensors were said to be worse."""
    lin = make(np.random.default_rng(4))
    t = np.arange(40)[None] * 0.01 + 0.4 * np.arange(40)[:, None]
    moved = np.einsum("wmnl,wl->wm", lin.impulse, size * np.sin(2 * np.pi * hertz * t))
    parts = variance.estimate(replace(lin, residual=lin.residual + moved))
    assert parts.sensor[0] < 1.5 and parts.force_std()[0] > 0.5 * size


def test_whitened_rows_are_white_and_free_of_initial_states():
    lin = make(np.random.default_rng(4), force_std=0.3)
    white = variance.whiten(lin, variance.whitener(lin, variance.estimate(lin)))
    assert np.sum(white.residual**2) / white.rows.sum() == pytest.approx(1.0, rel=0.1)
    moved = variance.whiten(
        variance.Linearised(**{**lin.__dict__, "residual": lin.residual + lin.jac_state @ np.array([0.3, -2.0])}),
        variance.whitener(lin, variance.estimate(lin)),
    )
    np.testing.assert_allclose(moved.residual, white.residual, atol=1e-6)


def test_unexplained_force_follows_the_truth():
    lin = make(np.random.default_rng(5), effect=0.4)
    mean, std = variance.unexplained_force(lin, variance.estimate(lin))
    t = np.arange(40)[None] * 0.01 + 0.4 * np.arange(40)[:, None]
    truth = 0.4 * np.sign(np.sin(2.1 * t + 0.5) + 0.7 * np.sin(5.3 * t))
    inner = slice(8, -8)  # a window's ends see no future
    assert np.corrcoef(mean[:, 0, inner].ravel(), truth[:, inner].ravel())[0, 1] > 0.8
    assert np.isfinite(std).all()
