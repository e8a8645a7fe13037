"""Derivatives of a smoothed success, and a modulus fitted to a track with the engine's derivative."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.models import scooping as model
from adaptsim_jax.models import scooping_fit
from adaptsim_jax.models.scooping import ScoopOptions
from adaptsim_jax.models.scooping_hydro import Numerics, Scoop

COARSE = Numerics(dt=0.005, grid=((4, 2), (4, 2), (2, 1), (2, 1)))
WD, ACTION = np.array([0.3, 5e4, 1.0, 0.02]), np.array([0.10, 0.0, 0.0125])


def _end(above, ahead):
    zero = jnp.zeros(())
    return Scoop(jnp.zeros((1, 3)), jnp.zeros((1, 3)), jnp.asarray(ahead), jnp.asarray(above), zero, zero)


def test_smooth_success_is_success_far_from_its_edges():
    level = lambda above, ahead: float(scooping_fit.smooth_success(_end(above, ahead), 1e-4))
    assert level(model.RISEN + 2e-3, -0.05) > 0.999 and level(model.RISEN - 2e-3, -0.05) < 1e-3
    assert level(model.RISEN, -0.05) == pytest.approx(0.5)
    assert level(0.01, model.RADIUS + 2e-3) < 1e-3 and level(0.01, -0.2) < 1e-3


def test_derivative_of_the_smoothed_chance_is_the_difference():
    """By friction, log modulus, pitch and distance, where no contact switches in between; double precision."""
    with jax.enable_x64(True):
        errors = jnp.zeros((1, 2))

        def chance(z):
            params = jnp.stack([z[0], jnp.exp(z[1]), jnp.ones(()), jnp.asarray(0.02)])
            action = jnp.stack([z[2], jnp.zeros(()), z[3]])
            return scooping_fit.smooth_chance(params, action, errors, ScoopOptions(), COARSE, 3e-3)

        both = jax.jit(jax.vmap(lambda z, v: jax.jvp(chance, (z,), (v,))))
        z = np.array([0.3, np.log(5e4), 0.10, 0.0125])
        step = 1e-8 * np.array([1.0, 10.0, 1.0, 1.0])
        points = np.concatenate([np.tile(z, (4, 1)), z + np.diag(step), z - np.diag(step)])
        values, slopes = (np.asarray(v) for v in both(jnp.asarray(points), jnp.asarray(np.tile(np.eye(4), (3, 1)))))
        numeric = (values[4:8] - values[8:]) / (2 * step)
        assert 0.0 < values[0] < 1.0 and np.abs(numeric).max() > 1e-2
        np.testing.assert_allclose(slopes[:4], numeric, rtol=2e-2, atol=1e-3 * np.abs(numeric).max())


def test_the_modulus_is_found_from_a_track():
    """Of WD's cylinder, from a start three times too stiff, with the piece's track until shortly after the blade met it."""
    with jax.enable_x64(True):
        seconds = 0.35
        track = jax.jit(scooping_fit.track_until(seconds, ScoopOptions(), COARSE))
        seen = np.asarray(track(jnp.asarray(WD), jnp.asarray(ACTION)))[:, :2]
        start = WD * np.array([1, 3, 1, 1])
        found = scooping_fit.fit_modulus(seen, start, ACTION, seconds=seconds, numerics=COARSE)
    assert found.modulus == pytest.approx(5e4, rel=0.02)
    assert found.error < 1e-5 and found.moduli[0] == pytest.approx(1.5e5)
