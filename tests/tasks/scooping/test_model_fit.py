"""A chance of success smoothed and differentiated, and a modulus fitted to a track with the
engine's derivative.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.tasks.scooping import hydro as scooping_hydro
from adaptsim_jax.tasks.scooping import model
from adaptsim_jax.tasks.scooping import trial as scooping_fit
from adaptsim_jax.tasks.scooping.model import Numerics, ScoopOptions
from experiments import scooping_gradient

COARSE = Numerics(dt=0.005, grid=((4, 2), (4, 2), (2, 1), (2, 1)))
WD, ACTION = np.array([0.3, 5e4, 1.0, 0.02]), np.array([0.10, 0.0, 0.0125])


def test_scaled_inputs_span_the_ranges():
    low = scooping_fit.scaled(jnp.asarray(model.LOW), jnp.asarray(model.ACTION_LOW))
    high = scooping_fit.scaled(jnp.asarray(model.HIGH), jnp.asarray(model.ACTION_HIGH))
    np.testing.assert_allclose(high - low, np.ones(6), rtol=1e-4)
    params, action = scooping_fit.unscaled(low, jnp.zeros(()))
    np.testing.assert_allclose(params, model.LOW, rtol=1e-4)
    np.testing.assert_allclose(action, model.ACTION_LOW, rtol=1e-4)


def test_the_smoothed_gradient_is_that_of_the_smoothed_chance(monkeypatch):
    """A rule instead of the engine: success where pitch and friction together lie over a line; a
    normal integral.
    """

    def rule(params, action, options, numerics):
        z = scooping_fit.scaled(params, action)
        won = (z[3] + 2 * z[0] > 4.5).astype(z.dtype)
        return scooping_hydro.Scoop(*[jnp.zeros(())] * 4, won, jnp.zeros(()))

    monkeypatch.setattr(scooping_fit.hydro, "rollout", rule)
    params, action = jnp.array([0.3, 5e4, 1.0, 0.02]), jnp.array([0.07, 0.0, 0.012])
    got = scooping_fit.smoothed(jax.random.key(0), params, action, spread=0.1, pairs=20000)
    z = scooping_fit.scaled(params, action)
    away, wide = float(z[3] + 2 * z[0] - 4.5), 0.1 * np.sqrt(5)
    slope = np.exp(-0.5 * (away / wide) ** 2) / (wide * np.sqrt(2 * np.pi))
    np.testing.assert_allclose(got.gradient, slope * np.array([2, 0, 0, 1, 0, 0]), atol=0.15)
    assert np.all(
        np.abs(np.asarray(got.gradient) - slope * np.array([2, 0, 0, 1, 0, 0]))
        < 5 * np.asarray(got.error)
    )


def test_the_modulus_is_found_from_an_early_track():
    """Of WD's cylinder, from a start three times too stiff, with the piece's track until shortly
    after the blade met it.
    """
    with jax.enable_x64(True):
        seconds = 0.15
        track = jax.jit(scooping_gradient.track_until(seconds, ScoopOptions(), COARSE))
        seen = np.asarray(track(jnp.asarray(WD), jnp.asarray(ACTION)))[:, :2]
        start = WD * np.array([1, 3, 1, 1])
        found = scooping_gradient.make_modulus_fit(seconds, numerics=COARSE)(seen, start, ACTION)
    assert found.modulus == pytest.approx(5e4, rel=0.02)
    assert found.error < 1e-5 and found.moduli[0] == pytest.approx(1.5e5)
