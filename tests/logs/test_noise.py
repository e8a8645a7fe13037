"""Noise by differences of rows."""

import numpy as np
import pytest

from adaptsim_jax.logs.noise import difference_noise, sensor_noise
from adaptsim_jax.logs.pendulum import read_pendulum
from tests.logs.measured_files import real_rig


@pytest.mark.parametrize("order", [2, 3, 4])
def test_the_noise_of_a_smooth_motion_is_found(order):
    rng, t = np.random.default_rng(0), np.arange(4000) * 0.004
    noise = np.array([1e-3, 3e-3])
    motion = np.stack([np.sin(3 * t), np.cos(2 * t)], 1)
    q = motion + noise * rng.normal(size=(4000, 2))
    np.testing.assert_allclose(difference_noise([q[:2500], q[2500:]], order), noise, rtol=0.08)
    np.testing.assert_allclose(difference_noise([q], order, robust=False), noise, rtol=0.08)
    assert 1e-3 < difference_noise([q], order, pooled=True)[0] < 3e-3


def test_what_was_never_read_has_no_noise():
    q = np.full((50, 2), np.nan)
    q[:, 0] = np.random.default_rng(0).normal(size=50)
    found = difference_noise([q])
    assert found[0] > 0.5 and found[1] == 0.0


def test_an_encoder_that_mostly_rests_has_the_noise_of_its_steps():
    rng, step = np.random.default_rng(0), 1e-3
    flips = step * np.round(rng.uniform(-0.5, 0.5, 400) + 0.45)
    rest = np.concatenate([np.zeros(600), flips])[:, None]
    moving = step * np.round(rng.normal(size=(1000, 1)))
    q = np.concatenate([rest, moving], 1)
    assert difference_noise([q])[0] == 0.0  # by medians, most rows are one value
    found = sensor_noise([q[:500], q[500:]])
    assert 0.1 * step < found[0] < step
    np.testing.assert_allclose(found[1], difference_noise([q[:500], q[500:]])[1])


@pytest.mark.parametrize("digits", [8, 17])
def test_a_coarse_encoder_in_a_table_has_the_noise_of_its_steps(digits):
    """At rest in most rows, 2048 steps a turn, at 500 Hz: what a table rounds off is no noise."""
    t, step = np.arange(4000) * 0.002, 2 * np.pi / 2048
    q = np.where(t < 5.0, 0.3, 0.3 + 0.2 * (1 - np.cos(2 * (t - 5.0))))
    written = np.array([float(f"{x:.{digits}g}") for x in step * np.round(q / step)])
    found = sensor_noise([written[:2000, None], written[2000:, None]])[0]
    assert 0.999 * step / np.sqrt(12) <= found < step
    fine = np.sin(t)[:, None] + 1e-5 * np.random.default_rng(0).normal(size=(4000, 1))
    np.testing.assert_array_equal(sensor_noise([fine]), difference_noise([fine]))


def test_a_constant_signal_has_no_noise():
    assert difference_noise([np.full(100, 3.0)]) == 0.0


@pytest.mark.parametrize("rig", ["rig_a", "rig_c"])
def test_the_real_rigs_have_encoder_noise(rig):
    floor = difference_noise([t.q for t in read_pendulum(real_rig(rig)).trials])
    # Between the least value that 14 bits allow (1.1e-4 rad) and one whole step of them.
    assert np.all((floor >= 1.1e-4) & (floor <= 3.9e-4))
