"""The push with a slide in two dimensions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.tasks.pushing import model, planar
from adaptsim_jax.tasks.pushing.slide import Push, slide

PARAMS = (0.1, 1e5, 0.4, 0.02)


@pytest.mark.parametrize("action", [(0.6, 0.0), (0.75, 0.25)])
def test_at_the_planar_step_it_is_the_planar_push(action):
    with jax.enable_x64(True):
        there = planar.trajectory(jnp.array(PARAMS), jnp.array(action), model.PushOptions(row=0.005))
        here = slide(Push(*PARAMS), jnp.array(action), step=0.005)[1:]
    np.testing.assert_allclose(here, there, atol=1e-6)


def test_a_tilted_table_draws_the_bottle_down_and_the_slope_by_it_is_that_of_differences():
    end = lambda tilt: slide(Push(*PARAMS, tilt_y=tilt), jnp.array([0.6, 0.0]), step=0.005)[-1, :2]
    with jax.enable_x64(True):
        assert float(end(0.01)[1]) > 1e-3 > abs(float(end(0.0)[1]))
        slope = jax.jacfwd(end)(0.01)
        np.testing.assert_allclose(slope, (end(0.0101) - end(0.0099)) / 2e-4, rtol=0.02, atol=1e-4)
    assert np.all(np.isfinite(jax.jacfwd(end)(0.0)))
