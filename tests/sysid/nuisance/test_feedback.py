"""Commands that answer to the motion: told from those that do not, whatever the trials' lengths."""

from types import SimpleNamespace

import numpy as np
import pytest

from adaptsim_jax.sysid.criteria import Criteria
from adaptsim_jax.sysid.nuisance.feedback import feedback_share, regulated

GAIN = np.array([[3.0, 1.0, 0.4, 0.2], [1.0, 2.0, 0.1, 0.3]])  # N m per rad, and per rad/s


def windows(noise: float, seed: int = 0, rows: int = 300):
    """Two trials of smooth motion, the second shorter and padded with its last row; commands are feedback and something else."""
    rng = np.random.default_rng(seed)
    t = 0.01 * np.arange(rows)
    hertz, phase = rng.uniform(0.5, 3.0, (2, 2)), rng.uniform(0.0, 6.0, (2, 2))
    angle = 2.0 * np.pi * hertz[:, None] * t[:, None] + phase[:, None]
    q, v = np.sin(angle), 2.0 * np.pi * hertz[:, None] * np.cos(angle)
    torque = -np.concatenate([q, v], 2) @ GAIN.T
    torque = torque + noise * torque.std() * np.cos(2.0 * np.pi * 4.3 * t + phase[:, :1])[..., None]
    time = np.stack([t, np.minimum(t, t[rows // 2])])
    for z in (q, v, torque):
        z[1, rows // 2 :] = z[1, rows // 2]
    return SimpleNamespace(time=time, motion_q=q, motion_v=v, torque=torque)


@pytest.mark.parametrize(("noise", "answers"), [(0.0, True), (0.5, True), (3.0, False)])
def test_a_feedback_is_told_from_commands_of_their_own(noise, answers):
    assert regulated(windows(noise), Criteria()) is answers


def test_the_share_is_that_of_the_feedback_and_padding_does_not_count():
    data = windows(1.0)
    data.torque[1, -50:] = 1e3
    feedback = windows(0.0).torque
    whole = data.torque[0]
    expected = 1.0 - np.var(whole - feedback[0], axis=0) / np.var(whole, axis=0)
    np.testing.assert_allclose(feedback_share(data), expected, atol=0.1)


def test_without_commands_nothing_is_answered():
    data = windows(0.0)
    data.torque[:] = 0.0
    assert feedback_share(data).shape == (0,) and not regulated(data, Criteria())


def test_joints_that_are_not_driven_do_not_count():
    data = windows(0.0)
    data.torque[..., 1] = 0.0
    assert feedback_share(data).shape == (1,) and regulated(data, Criteria())
