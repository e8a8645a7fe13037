"""The rigid-body pendulum against a Newton-Euler recursion in NumPy, an integrator, and conservation of energy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from adaptsim_jax.mechanisms.double_pendulum import rigid as pd
from adaptsim_jax.mechanisms.double_pendulum.linear import linearized
from adaptsim_jax.mechanisms.registry import make_plant

LINKS = dict(mass=(1.3, 0.7), length=(0.8, 0.5), com=(0.35, 0.3), inertia=(0.07, 0.02), damping=(0.15, 0.08))


# Compiled whole: thousands of single operations are slow on a busy machine.
base_forward = jax.jit(pd.base_forward_dynamics)
base_form = jax.jit(lambda p: (pd.base_parameters(p), pd.base_geometry(p)))


def links(angle_zero="hanging", **changes):
    """The pendulum of `LINKS`, with some of it changed."""
    arrays = {name: jnp.asarray(values, float) for name, values in (LINKS | changes).items()}
    return pd.RigidPendulum(**arrays, angle_zero=angle_zero)


def newton_euler(p, q, v, a):
    """Joint torques by forces on each body; shares nothing with the package but the parameters."""
    m, l, c, I, b = (np.asarray(x, float) for x in (p.mass, p.length, p.com, p.inertia, p.damping))
    g = float(p.gravity)
    zero = -np.pi / 2 if p.angle_zero == "hanging" else np.pi / 2  # from the horizontal
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


def accelerations(p, q, v, tau):
    """Forward dynamics by probing `newton_euler` with unit accelerations."""
    rest = newton_euler(p, q, v, np.zeros(2))
    M = np.stack([newton_euler(p, q, v, e) - rest for e in np.eye(2)], axis=1)
    return np.linalg.solve(M, tau - rest)


@pytest.mark.parametrize("angle_zero", ["hanging", "upright"])
def test_dynamics_are_newton_euler(x64, angle_zero):
    p = links(angle_zero)
    theta, geometry = base_form(p)
    rng = np.random.default_rng(0)
    for q, v, a in rng.normal(size=(20, 3, 2)) * 2:
        np.testing.assert_allclose(base_forward(theta, geometry, q, v, newton_euler(p, q, v, a)), a, atol=1e-9)


def test_base_parameters_are_all_that_motion_sees(x64):
    """Other links with the same base parameters, and the inertial parameters themselves, move alike."""
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
    theta, geometry = base_form(p)
    np.testing.assert_allclose(jax.jit(pd.base_parameters)(other), theta, rtol=1e-12)
    for q, v, tau in np.random.default_rng(1).normal(size=(10, 3, 2)):
        expected = accelerations(p, q, v, tau)
        np.testing.assert_allclose(accelerations(other, q, v, tau), expected, rtol=1e-7)
        np.testing.assert_allclose(base_forward(theta, geometry, q, v, tau), expected, rtol=1e-7)


@pytest.mark.parametrize("angle_zero", ["hanging", "upright"])
def test_simulation_is_what_an_integrator_finds(x64, angle_zero):
    p = links(angle_zero)
    plain = jax.tree.map(np.asarray, p)
    dt = np.array([0.01, 0.02, 0.015, 0.01] * 25)  # uneven sampling
    tau = np.random.default_rng(3).normal(size=(100, 2))
    ours = jax.jit(pd.simulate, static_argnums=5)(p, jnp.array([0.4, -0.2]), jnp.zeros(2), tau, dt, 8)
    x = np.array([0.4, -0.2, 0, 0])
    for row, hold in zip(tau, dt, strict=True):
        flow = solve_ivp(
            lambda _, x, row=row: np.r_[x[2:], accelerations(plain, x[:2], x[2:], row)],
            (0, hold),
            x,
            rtol=1e-9,
            atol=1e-11,
        )
        x = flow.y[:, -1]
    # RK4 at 2.5 ms at most: local error about (0.0025 * 10 rad/s)^5.
    np.testing.assert_allclose(np.r_[ours.q[-1], ours.v[-1]], x, atol=1e-5)
    assert ours.q.shape == (101, 2) and int(ours.code) == 0


def energy(p, q, v):
    """Kinetic plus potential energy J of bodies that hang, by their velocities and heights."""
    (m1, m2), (l1, _), (c1, c2), (I1, I2) = p.mass, p.length, p.com, p.inertia
    along = lambda i, r: r * jnp.array([jnp.cos(jnp.sum(q[: i + 1])), jnp.sin(jnp.sum(q[: i + 1]))])
    rate = lambda i, r: along(i, r) * jnp.sum(v[: i + 1])
    kinetic = m1 * jnp.sum(rate(0, c1) ** 2) + m2 * jnp.sum((rate(0, l1) + rate(1, c2)) ** 2)
    turning = I1 * v[0] ** 2 + I2 * jnp.sum(v) ** 2
    return 0.5 * (kinetic + turning) - p.gravity * (m1 * along(0, c1)[0] + m2 * (along(0, l1) + along(1, c2))[0])


@settings(max_examples=15, deadline=None)
@given(q=st.tuples(*[st.floats(-3, 3)] * 2), v=st.tuples(*[st.floats(-4, 4)] * 2))
def test_energy_is_kept_without_damping_and_lost_with(q, v):
    with jax.enable_x64(True):
        for damping in ((0.0, 0.0), (0.1, 0.1)):
            p = links(damping=damping)
            path = run(p, jnp.asarray(q), jnp.asarray(v))
            change = float(energy(p, path.q[-1], path.v[-1]) - energy(p, path.q[0], path.v[0]))
            if damping[0] == 0:
                assert abs(change) < 1e-6
            else:
                lost = np.trapezoid(np.sum(np.asarray(p.damping) * np.asarray(path.v) ** 2, axis=1), dx=0.005)
                assert change == pytest.approx(-lost, abs=1e-3 * (1 + lost))


@jax.jit
def run(p, q, v):
    return pd.simulate(p, q, v, jnp.zeros((200, 2)), 0.005, 4)


@pytest.mark.parametrize("angle_zero", ["hanging", "upright"])
def test_linearization_is_the_linear_model(x64, angle_zero):
    upright = jnp.zeros(2) if angle_zero == "upright" else jnp.array([jnp.pi, 0.0])
    for m1, m2, b1, b2 in [(1.8, 0.3, 1.5, 1.5), (0.4, 2.6, 1.0, 2.0)]:
        p = links(angle_zero, mass=(m1, m2), length=(1, 1), com=(1, 1), inertia=(0, 0), damping=(b1, b2))
        theta, geometry = base_form(p)

        def deriv(x, tau, theta=theta, geometry=geometry):
            return jnp.concatenate([x[2:], base_forward(theta, geometry, x[:2], x[2:], tau)])

        ours = jax.jacfwd(deriv, (0, 1))(jnp.concatenate([upright, jnp.zeros(2)]), jnp.zeros(2))
        for one, other in zip(ours, linearized(jnp.array([m1, m2, b1, b2])), strict=True):
            np.testing.assert_allclose(one, other, atol=1e-10)


def test_single_precision_batch_and_divergence():
    p = links()
    starts = jnp.asarray(np.random.default_rng(0).normal(size=(8, 2)), jnp.float32)
    paths = jax.jit(jax.vmap(run, in_axes=(None, 0, 0)))(p, starts, starts)
    assert paths.q.shape == (8, 201, 2) and paths.q.dtype == jnp.float32 and not paths.code.any()
    assert int(run(p, jnp.array([jnp.nan, 0.0]), jnp.zeros(2)).code) == 1


def test_regressed_inertias_that_no_bodies_have_are_raised():
    """Slow motions say little of inertias; what a regression makes of them must still be simulated."""
    plant = make_plant("rigid_body", "upright", {"l1": 0.309})
    impossible = np.array([0.1706, 0.0341, 0.656, 0.240, 0.59, 0.025])  # det M < 0 at some angles
    q = jnp.stack([jnp.zeros(64), jnp.linspace(-np.pi, np.pi, 64)])
    smallest = lambda theta: float(jnp.linalg.eigvalsh(jnp.moveaxis(plant.mass_matrix(theta, q), -1, 0)).min())
    assert smallest(impossible) < 0
    mended = plant.sound(plant.constants, impossible)
    assert smallest(mended) > 0
    np.testing.assert_array_equal(mended[2:], impossible[2:])
    fine = np.array([0.3, 0.05, 0.656, 0.240, 0.59, 0.025])
    np.testing.assert_array_equal(plant.sound(plant.constants, fine), fine)
