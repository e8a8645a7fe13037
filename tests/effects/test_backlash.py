"""The play of an encoder: what it reads after turning back depends on how far the link went,
between rows too.
"""

import jax.numpy as jnp
import numpy as np

from adaptsim_jax.effects.joints.sensor import backlash


def read(rate: float, gap: float = 0.1):
    """Times and reading of a swing of 1 rad whose turning points lie between rows, the reading
    starting behind the link.
    """
    t = (np.arange(0, 3.0, 1 / rate) + 0.1)[:, None]
    q, v = np.sin(7.0 * t), 7.0 * np.cos(7.0 * t)
    p = {"gap": jnp.full((1, 1), gap)}
    reading, speed = backlash(
        p, jnp.asarray(t), jnp.asarray(q), jnp.asarray(v), jnp.asarray(q[0] - gap / 2)
    )
    return t[:, 0], np.asarray(reading)[:, 0], np.asarray(speed)[:, 0]


def test_a_turn_between_rows_is_not_lost():
    time, reading, _ = read(100.0)
    fine_time, fine, _ = read(20000.0)
    want = np.interp(time, fine_time, fine)
    assert (
        np.abs(reading - want).max() < 3e-4
    )  # the angle rows of 10 ms see falls up to 6e-4 short of the turn
    held = np.abs(np.diff(want)) < 1e-6
    assert held.sum() > 20 and np.abs(reading - want)[1:][held].max() < 1e-4


def test_the_reading_follows_at_half_the_gap_and_stands_while_the_play_is_taken_up():
    time, reading, speed = read(1000.0)
    q = np.sin(7.0 * time)
    assert np.all(np.abs(reading - q) <= 0.05 + 1e-6)
    moving = speed != 0.0
    assert 0.5 < moving.mean() < 0.95
    behind = np.sign(np.cos(7.0 * time[moving])) * (q - reading)[moving]
    np.testing.assert_allclose(behind, 0.05, atol=2e-4)
