"""Fitted values that make an effect another one: a spring without stiffness, a stop that is always leaned on, a drift that stays."""

import numpy as np
import pytest

from adaptsim_jax.effects.base import Parameter
from adaptsim_jax.effects.registry import catalogue
from adaptsim_jax.sysid.estimate.fit import _is_nothing

ANGLES = np.linspace(-1.0, 1.0, 201)
TRIAL = 6.0  # s


@pytest.mark.parametrize(
    ("name", "value", "error", "reason"),
    [
        ("spring", {"stiffness": 0.1, "preload": 0.3}, {"stiffness": 0.01}, ""),
        ("spring", {"stiffness": 0.001, "preload": 0.3}, {"stiffness": 0.001}, "constant torque"),
        ("hard_stop", {"angle": 0.8, "side": 1.0}, {}, ""),
        ("hard_stop", {"angle": -0.8, "side": -1.0}, {}, ""),
        ("hard_stop", {"angle": -0.5, "side": 1.0}, {}, "lean on it 75 % of the time"),
        ("friction_drift", {"viscous": 0.1, "dry": 0.0, "decay": 8.0}, {}, ""),
        ("friction_drift", {"viscous": -0.04, "dry": 0.03, "decay": 94.0}, {}, "fades by 6 % in a trial"),
        ("stribeck", {"level": 0.3, "excess": 0.1, "speed": 0.5}, {}, ""),
        ("stribeck", {"level": 0.0, "excess": 0.1, "speed": 0.5}, {}, ""),
        ("stribeck", {"level": 0.32, "excess": 0.0037, "speed": 4.3}, {}, "1 % higher at rest"),
        ("torque_gain", {"gain": -0.5}, {"gain": 0.1}, ""),
        ("torque_gain", {"gain": 1.5}, {"gain": 0.5}, ""),
        ("torque_gain", {"gain": -0.888}, {"gain": 0.1}, "leave 0 % of the torque"),
        ("torque_gain", {"gain": -0.7}, {"gain": 0.1}, "leave 14 % of the torque"),
        ("cogging", {"order": 7.0}, {}, ""),
        ("cogging", {"order": 1.5}, {}, "0.5 of its periods"),
        ("periodic_disturbance", {"frequency": 0.7}, {}, ""),
        ("periodic_disturbance", {"frequency": 0.16}, {}, "1.0 of its periods"),
    ],
)
def test_what_the_fitted_values_say_of_an_effect(name, value, error, reason):
    (effect,) = [e for e in catalogue() if e.name == name]
    assert effect.amiss is not None
    why = effect.amiss(value, error, ANGLES, TRIAL)
    assert (reason in why) if reason else why == ""


@pytest.mark.parametrize(
    ("fitted", "nothing"),
    [
        ({"lag": (0.05, 0.03)}, False),
        ({"lag": (0.05, 0.04)}, True),
        ({"sine": (0.1, 1.0), "cosine": (0.5, 0.1)}, False),
        ({"sine": (0.1, 1.0), "cosine": (0.5, 0.6)}, True),
        ({}, False),
    ],
)
def test_a_size_that_may_be_none_is_no_effect(fitted, nothing):
    amplitudes = [Parameter(name, "1", -1.0, 1.0, 0.0) for name in ("lag", "sine", "cosine")]
    assert _is_nothing(amplitudes, fitted) is nothing
