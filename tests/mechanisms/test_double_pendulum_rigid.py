"""The rigid-body pendulum against a Newton-Euler recursion in NumPy, an integrator, and
conservation of energy.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from adaptsim_jax.core.constants import GRAVITY
from adaptsim_jax.mechanisms.double_pendulum.linear import linearized
from adaptsim_jax.mechanisms.double_pendulum.plant import base_parameters
from adaptsim_jax.mechanisms.registry import make_plant
from adaptsim_jax.mechanisms.stepping import Instant, Sample, make_model, row_step

LINKS = dict(
    mass=(1.3, 0.7), length=(0.8, 0.5), com=(0.35, 0.3), inertia=(0.07, 0.02), damping=(0.15, 0.08)
)


class Links(NamedTuple):
    """Inertial parameters of both links, each `[2]`, in SI units."""

    mass: Any
    length: Any
    com: Any
    inertia: Any
    damping: Any


def links(**changes):
    """The pendulum of `LINKS`, with some of it changed."""
    return Links(**{name: jnp.asarray(values, float) for name, values in (LINKS | changes).items()})


@jax.jit
def base_form(p):
    return base_parameters(p.mass, p.length[0], p.com, p.inertia, p.damping)


def plant_of(p, angle_zero="hanging"):
    return make_plant("rigid_body", angle_zero, {"l1": float(p.length[0])})


# Compiled whole: thousands of single operations are slow on a busy machine.
@jax.jit
def base_forward(plant, theta, q, v, tau):
    return plant.deriv(theta, jnp.concatenate([q, v]), tau, jnp.zeros(2), jnp.zeros(2))[2:]


@jax.jit
def simulated(plant, theta, q, v, tau, dt):
    """States `[T + 1, 4]` from `q, v [2]` under torques `tau [T, 2]`, each held for `dt [T]` s."""
    model = make_model(plant, ())

    def row(x, held):
        u, h = held
        x, _ = row_step(
            Sample(model, theta, jnp.zeros(0)),
            Instant(list(x[:, None]), (), u[:, None], 0.0),
            h[None],
        )
        x = jnp.stack(x)[:, 0]
        return x, x

    start = jnp.concatenate([q, v])
    return jnp.concatenate([start[None], jax.lax.scan(row, start, (tau, dt))[1]])


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


def accelerations(p, q, v, tau, angle_zero="hanging"):
    """Forward dynamics by probing `newton_euler` with unit accelerations."""
    rest = newton_euler(p, q, v, np.zeros(2), angle_zero)
    M = np.stack([newton_euler(p, q, v, e, angle_zero) - rest for e in np.eye(2)], axis=1)
    return np.linalg.solve(M, tau - rest)


@pytest.mark.parametrize("angle_zero", ["hanging", "upright"])
def test_dynamics_are_newton_euler(x64, angle_zero):
    p = links()
    theta, plant = base_form(p), plant_of(p, angle_zero)
    rng = np.random.default_rng(0)
    for q, v, a in rng.normal(size=(20, 3, 2)) * 2:
        np.testing.assert_allclose(
            base_forward(plant, theta, q, v, newton_euler(p, q, v, a, angle_zero)), a, atol=1e-9
        )


def test_base_parameters_are_all_that_motion_sees(x64):
    """Other links with the same base parameters, and the inertial parameters themselves, move
    alike.
    """
    p = links()
    m1, m2 = 1.5, 0.6  # other masses; centres and inertias chosen to keep p1, p3, h1, h2
    l1, (c1, c2) = LINKS["length"][0], LINKS["com"]
    h1, h2 = LINKS["mass"][0] * c1 + LINKS["mass"][1] * l1, LINKS["mass"][1] * c2
    com = ((h1 - m2 * l1) / m1, h2 / m2)
    I2 = LINKS["inertia"][1] + LINKS["mass"][1] * c2**2 - m2 * com[1] ** 2
    link1 = LINKS["inertia"][0] + LINKS["mass"][0] * c1**2 + LINKS["mass"][1] * l1**2
    I1 = link1 - m1 * com[0] ** 2 - m2 * l1**2
    assert I1 > 0 and I2 > 0
    other = links(mass=(m1, m2), com=com, inertia=(I1, I2))
    theta, plant = base_form(p), plant_of(p)
    np.testing.assert_allclose(base_form(other), theta, rtol=1e-12)
    for q, v, tau in np.random.default_rng(1).normal(size=(10, 3, 2)):
        expected = accelerations(p, q, v, tau)
        np.testing.assert_allclose(accelerations(other, q, v, tau), expected, rtol=1e-7)
        np.testing.assert_allclose(base_forward(plant, theta, q, v, tau), expected, rtol=1e-7)


@pytest.mark.parametrize("angle_zero", ["hanging", "upright"])
def test_simulation_is_what_an_integrator_finds(x64, angle_zero):
    p = links()
    plain = jax.tree.map(np.asarray, p)
    dt = np.array([0.01, 0.02, 0.015, 0.01] * 25)  # uneven sampling
    tau = np.random.default_rng(3).normal(size=(100, 2))
    fine = np.repeat(tau, 8, 0), np.repeat(dt / 8, 8)
    ours = simulated(
        plant_of(p, angle_zero), base_form(p), jnp.array([0.4, -0.2]), jnp.zeros(2), *fine
    )
    x = np.array([0.4, -0.2, 0, 0])
    for row, hold in zip(tau, dt, strict=True):
        flow = solve_ivp(
            lambda _, x, row=row: np.r_[x[2:], accelerations(plain, x[:2], x[2:], row, angle_zero)],
            (0, hold),
            x,
            rtol=1e-9,
            atol=1e-11,
        )
        x = flow.y[:, -1]
    # RK4 at 2.5 ms at most: local error about (0.0025 * 10 rad/s)^5.
    np.testing.assert_allclose(ours[-1], x, atol=1e-5)


def energy(p, q, v):
    """Kinetic plus potential energy J of bodies that hang, by their velocities and heights."""
    (m1, m2), (l1, _), (c1, c2), (I1, I2) = p.mass, p.length, p.com, p.inertia

    def along(i, r):
        return r * jnp.array([jnp.cos(jnp.sum(q[: i + 1])), jnp.sin(jnp.sum(q[: i + 1]))])

    def rate(i, r):
        return along(i, r) * jnp.sum(v[: i + 1])

    kinetic = m1 * jnp.sum(rate(0, c1) ** 2) + m2 * jnp.sum((rate(0, l1) + rate(1, c2)) ** 2)
    turning = I1 * v[0] ** 2 + I2 * jnp.sum(v) ** 2
    return 0.5 * (kinetic + turning) - GRAVITY * (
        m1 * along(0, c1)[0] + m2 * (along(0, l1) + along(1, c2))[0]
    )


@settings(max_examples=15, deadline=None)
@given(q=st.tuples(*[st.floats(-3, 3)] * 2), v=st.tuples(*[st.floats(-4, 4)] * 2))
def test_energy_is_kept_without_damping_and_lost_with(q, v):
    with jax.enable_x64(True):
        for damping in ((0.0, 0.0), (0.1, 0.1)):
            p = links(damping=damping)
            path = run(p, jnp.asarray(q), jnp.asarray(v))[::4]
            change = float(
                energy(p, path[-1, :2], path[-1, 2:]) - energy(p, path[0, :2], path[0, 2:])
            )
            if damping[0] == 0:
                assert abs(change) < 1e-6
            else:
                lost = np.trapezoid(
                    np.sum(np.asarray(p.damping) * np.asarray(path[:, 2:]) ** 2, axis=1), dx=0.005
                )
                assert change == pytest.approx(-lost, abs=1e-3 * (1 + lost))


def run(p, q, v):
    """A second without torques, in steps of 1.25 ms."""
    return simulated(plant_of(p), base_form(p), q, v, jnp.zeros((800, 2)), jnp.full(800, 0.00125))


@pytest.mark.parametrize("angle_zero", ["hanging", "upright"])
def test_linearization_is_the_linear_model(x64, angle_zero):
    upright = jnp.zeros(2) if angle_zero == "upright" else jnp.array([jnp.pi, 0.0])
    for m1, m2, b1, b2 in [(1.8, 0.3, 1.5, 1.5), (0.4, 2.6, 1.0, 2.0)]:
        p = links(mass=(m1, m2), length=(1, 1), com=(1, 1), inertia=(0, 0), damping=(b1, b2))
        theta, plant = base_form(p), plant_of(p, angle_zero)

        def deriv(x, tau, theta=theta, plant=plant):
            return jnp.concatenate([x[2:], base_forward(plant, theta, x[:2], x[2:], tau)])

        ours = jax.jacfwd(deriv, (0, 1))(jnp.concatenate([upright, jnp.zeros(2)]), jnp.zeros(2))
        for one, other in zip(ours, linearized(jnp.array([m1, m2, b1, b2])), strict=True):
            np.testing.assert_allclose(one, other, atol=1e-10)


def test_single_precision_batch_and_divergence():
    p = links()
    starts = jnp.asarray(np.random.default_rng(0).normal(size=(8, 2)), jnp.float32)
    paths = jax.vmap(lambda q, v: run(p, q, v))(starts, starts)
    assert paths.shape == (8, 801, 4) and paths.dtype == jnp.float32 and np.isfinite(paths).all()
    assert not np.isfinite(run(p, jnp.array([jnp.nan, 0.0]), jnp.zeros(2))[-1]).all()
