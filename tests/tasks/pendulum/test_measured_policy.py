"""Torques of a measured trial against the policy that was asked for."""

import numpy as np
import pytest

from adaptsim_jax.tasks.pendulum.measured import START, check_policy

GAIN = np.array([[90.0, 30.0, 35.0, 14.0], [40.0, 35.0, 18.0, 10.0]])
TIME = np.arange(0.0, 2.5, 0.005)


def trial(gain=GAIN, limit=60.0, late=0, speeds=False):
    q = np.stack(
        [
            START[0] * np.exp(-2.0 * TIME) * np.cos(3.0 * TIME),
            0.8 * np.exp(-TIME) * np.sin(5.0 * TIME),
        ],
        1,
    )
    v = np.gradient(q, TIME, axis=0)
    tau = np.clip(-np.concatenate([q, v], 1) @ gain.T, -limit, limit)
    q = q + 1e-4 * np.random.default_rng(0).normal(size=q.shape)
    tau = np.roll(tau, late, 0)
    columns = {"time": TIME, "q1": q[:, 0], "q2": q[:, 1], "tau1": tau[:, 0], "tau2": tau[:, 1]}
    return columns | ({"v1": v[:, 0], "v2": v[:, 1]} if speeds else {})


@pytest.mark.parametrize("speeds", [False, True])
def test_the_policy_that_was_asked_for_is_taken_whatever_limit_its_drives_have(speeds):
    assert check_policy(trial(speeds=speeds), GAIN) == ""
    assert check_policy(trial(limit=1e3, speeds=speeds), GAIN) == ""


@pytest.mark.parametrize(
    "other", [{"gain": 0.3 * GAIN}, {"late": 60}, {"limit": 3.0}, {"gain": -GAIN}]
)
def test_another_policy_a_late_log_and_one_cut_off_are_told(other):
    assert "is not what the policy asks for" in check_policy(trial(**other), GAIN)
