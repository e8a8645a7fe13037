"""A lagging sensor in mid-motion trails a constant acceleration by what the filter's differential
equation says.
"""

import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.effects.joints.sensor import sensor_lag


def lagged(begin: float, lag: float, accel: float):
    """Times, true angle and velocity of a constant acceleration from rest at 0 s, and what the
    sensor says of them.
    """
    t = np.linspace(begin, begin + 0.5, 101)[:, None]
    q, v = 0.5 * accel * t**2, accel * t
    p = {"lag": jnp.full((1, 1), lag)}
    return t, q, v, sensor_lag(p, jnp.asarray(t), jnp.asarray(q), jnp.asarray(v), jnp.asarray(q[0]))


@pytest.mark.parametrize("lag", [0.002, 0.026, 0.08])
def test_a_stretch_that_begins_in_mid_motion_starts_on_the_filtered_motion(lag):
    accel = 50.0
    _, q, v, (angle, speed) = lagged(1.0, lag, accel)
    np.testing.assert_allclose(
        angle, q - lag * v + lag**2 * accel, atol=2e-5
    )  # the solution of lag y' = q - y, transients gone
    np.testing.assert_allclose(speed, v - lag * accel, atol=1e-4)


def test_where_a_trial_begins_nothing_is_known_of_its_past():
    _, q, v, (angle, _) = lagged(0.0, 0.026, 50.0)
    assert abs(float(angle[0, 0]) - float(q[0, 0])) < 1e-6  # at rest: the sensor has caught up
    assert np.all(np.asarray(angle)[1:] > np.asarray(q - 0.026 * v)[1:])
