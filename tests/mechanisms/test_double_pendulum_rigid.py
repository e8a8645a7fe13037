"""A double pendulum written as MJCF, read as a tree, against a Newton-Euler recursion in NumPy."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.core.constants import GRAVITY
from adaptsim_jax.mechanisms import dynamics
from adaptsim_jax.mechanisms.double_pendulum.plant import double_pendulum_mjcf
from adaptsim_jax.mechanisms.mjcf import read_mechanism


class Links(NamedTuple):
    """Inertial parameters of both links, each `[2]`, in SI units."""

    mass: Any = (1.3, 0.7)
    length: Any = (0.8, 0.5)
    com: Any = (0.35, 0.3)
    inertia: Any = (0.07, 0.02)
    damping: Any = (0.15, 0.08)


def base_form(p: Links) -> np.ndarray:
    """p1, p3, h1, h2, b1, b2."""
    (m1, m2), (c1, c2), (I1, I2), l1 = p.mass, p.com, p.inertia, p.length[0]
    p3 = I2 + m2 * c2**2
    p1 = I1 + m1 * c1**2 + p3 + m2 * l1**2
    return np.array([p1, p3, m1 * c1 + m2 * l1, m2 * c2, *p.damping])


def newton_euler(p, q, v, a, angle_zero="hanging"):
    """Joint torques by forces on each body; shares nothing with the package but the parameters."""
    m, l, c, I, b = (np.asarray(x, float) for x in p)
    g = GRAVITY
    zero = -np.pi / 2 if angle_zero == "hanging" else np.pi / 2  # from the horizontal
    angle, rate, turn = np.cumsum(q), np.cumsum(v), np.cumsum(a)

    def along(i, length):  # acceleration of a point on link i, relative to its joint
        e = np.array([np.cos(zero + angle[i]), np.sin(zero + angle[i])])
        return length * (turn[i] * np.array([-e[1], e[0]]) - rate[i] ** 2 * e), length * e

    def cross(r, f):
        return r[0] * f[1] - r[1] * f[0]

    up = np.array([0.0, g])
    com1, arm1 = along(0, c[0])
    elbow, reach = along(0, l[0])
    com2, arm2 = along(1, c[1])
    force2 = m[1] * (elbow + com2 + up)
    on_link2 = I[1] * turn[1] + cross(arm2, force2)
    on_link1 = I[0] * turn[0] + cross(arm1, m[0] * (com1 + up)) + cross(reach, force2)
    return np.array([on_link1 + on_link2 + b[0] * v[0], on_link2 + b[1] * v[1]])


@pytest.mark.parametrize("angle_zero", ["hanging", "upright"])
def test_dynamics_are_newton_euler(x64, tmp_path, angle_zero):
    """Other links with the same base parameters are written, and move alike."""
    p, file = Links(), tmp_path / "pendulum.xml"
    file.write_text(double_pendulum_mjcf(base_form(p), {"l1": p.length[0]}, angle_zero))
    tree = read_mechanism(file).tree
    inertial, gravity = jnp.asarray(tree.inertial), jnp.asarray(tree.gravity)

    @jax.jit
    def forward(q, v, tau):
        return dynamics.acceleration(tree, inertial, q, v, tau, jnp.zeros(2), gravity)

    for q, v, a in np.random.default_rng(0).normal(size=(20, 3, 2)) * 2:
        force = newton_euler(p, q, v, a, angle_zero) - np.asarray(p.damping) * v
        np.testing.assert_allclose(forward(q, v, force), a, rtol=1e-6, atol=1e-6)
