"""What a moving base does to a hanging double pendulum, against gravity and inertia written as
vectors.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.effects.base import Motion
from adaptsim_jax.effects.registry import catalogue, effect_named

G, H1, H2 = 9.81, 0.3, 0.11  # m/s^2; kg m


def felt(q, down, right):
    """Joint torques of accelerations `down`, `right` m/s^2 that every mass feels, link by link."""
    a, b = q[0], q[0] + q[1]
    lower = H2 * (right * np.cos(b) - down * np.sin(b))
    return np.stack([H1 * (right * np.cos(a) - down * np.sin(a)) + lower, lower])


@pytest.mark.parametrize("name", ["heave", "sway"])
def test_a_moving_base_is_felt_as_another_gravity(name):
    with jax.enable_x64(True):
        t = np.linspace(0.0, 2.0, 50)
        q = np.stack([1.3 * np.sin(2.0 * t), 0.9 * np.cos(3.0 * t)])

        def gravity(q):
            return jnp.asarray(felt(np.asarray(q), G, 0.0))

        m = Motion(
            jnp.asarray(q),
            jnp.zeros((2, 50)),
            jnp.zeros((2, 50)),
            jnp.asarray(t[None]),
            jnp.zeros((2, 50)),
            gravity,
        )

        def number(x):
            return jnp.full((1, 1), x)

        p = {"sine": number(0.2), "cosine": number(-0.1), "frequency": number(1.3)}
        got = effect_named(name, catalogue()).apply(p, m)
        turn = 2.0 * np.pi * 1.3 * t
        base = G * (0.2 * np.sin(turn) - 0.1 * np.cos(turn))  # m/s^2: upwards, or to the left
        down, right = (base, 0.0) if name == "heave" else (0.0, -base)
        np.testing.assert_allclose(got, felt(q, down, right), atol=1e-12)
