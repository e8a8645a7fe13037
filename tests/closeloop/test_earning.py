"""What an effect must earn: likelihood for its price, and a torque that matters or all that is missing."""

from types import SimpleNamespace

import numpy as np
import pytest

from adaptsim_jax.closeloop.earning import Settings, earns

PROBLEM = SimpleNamespace(torque_scale=np.array([1.0, 1.0]))


def model(active, force, total):
    """A fitted model that leaves `force` [N m] of a joint's 1 N m unexplained."""
    return SimpleNamespace(active=active, size=6 + len(active), total=total, moving=np.array([force**2, 0.0]))


@pytest.mark.parametrize(
    ("force", "left", "gain", "expected"),
    [
        (0.05, 0.01, 30.0, True),
        (0.05, 0.01, 9.0, False),  # not likelier by its price
        (0.05, 0.049, 30.0, False),  # leaves the force as it was
        (0.003, 0.0001, 30.0, False),  # too small to matter
        (0.003, 0.0001, 300.0, True),  # as small, but all that is missing, and no chance
        (0.003, 0.001, 300.0, False),  # no chance, but a third is left
    ],
)
def test_what_a_first_effect_must_earn(force, left, gain, expected):
    base = model((), force, 0.0)
    assert earns(PROBLEM, model((("sensor_lag", "joint1"),), left, gain), base, base, Settings()) is expected


def test_a_small_second_effect_or_a_small_pair_must_matter():
    base = model((), 0.003, 0.0)
    first = model((("bias", "joint1"),), 0.002, 150.0)
    both = model((("bias", "joint1"), ("spring", "joint2")), 0.0001, 900.0)
    assert not earns(PROBLEM, both, first, base, Settings())
    assert not earns(PROBLEM, both, base, base, Settings())
