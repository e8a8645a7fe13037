"""A torque constant that is off at one joint, told as that of the other in another scale."""

import numpy as np
import pytest

from adaptsim_jax.effects.layout import Layout
from adaptsim_jax.effects.registry import catalogue
from adaptsim_jax.mechanisms.double_pendulum.rigid import Geometry, base_forward_dynamics
from adaptsim_jax.sysid.rivals.torque_scale import other_scale

THETA = np.array([0.4, 0.15, 0.7, 0.4, 0.01, 0.02])
LAYOUT = Layout(catalogue(), ("joint1", "joint2"))
HERE, THERE = ("torque_gain", "joint2"), ("torque_gain", "joint1")


def value(eff, name, where, parameter):
    instance = LAYOUT.instances[LAYOUT.index(name, where)]
    return eff[instance.at][[p.name for p in instance.effect.parameters].index(parameter)]


@pytest.mark.parametrize("gain", [-0.4, 0.7])
def test_both_scales_move_alike(gain):
    eff = LAYOUT.off()
    eff[LAYOUT.instances[LAYOUT.index(*HERE)].at.start] = gain
    eff[LAYOUT.instances[LAYOUT.index("spring", "joint1")].at.start] = 0.3
    active = (HERE, ("spring", "joint1"), ("backlash", "joint1"))
    theta, other = other_scale(LAYOUT, THETA, eff, active, HERE, THERE)
    geometry, q, v, u = Geometry(0.35), np.array([0.3, -0.5]), np.array([1.0, -2.0]), np.array([0.5, -0.8])

    def acceleration(theta, eff):
        gains = np.array([value(eff, "torque_gain", j, "gain") for j in ("joint1", "joint2")])
        pull = np.array([-value(eff, "spring", "joint1", "stiffness") * q[0], 0.0])
        return np.asarray(base_forward_dynamics(theta, geometry, q, v, (1.0 + gains) * u + pull))

    np.testing.assert_allclose(acceleration(theta, other), acceleration(THETA, eff), rtol=1e-4)
    assert value(other, "torque_gain", "joint2", "gain") == 0.0
    assert value(other, "backlash", "joint1", "gap") == value(eff, "backlash", "joint1", "gap")
