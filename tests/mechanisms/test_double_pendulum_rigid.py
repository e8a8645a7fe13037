"""The rigid-body pendulum against a Newton-Euler recursion in NumPy, an integrator, and conservation of energy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.mechanisms.double_pendulum import rigid as pd
from adaptsim_jax.mechanisms.double_pendulum.linear import linearized
from adaptsim_jax.mechanisms.registry import make_plant

LINKS = dict(mass=(1.3, 0.7), length=(0.8, 0.5), com=(0.35, 0.3), inertia=(0.07, 0.02), damping=(0.15, 0.08))
ROTORS = dict(rotor_inertia=(2e-4, 3e-4), gear=(6.0, -9.0))


# Compiled whole: thousands of single operations are slow on a busy machine.
forward, inverse = jax.jit(pd.forward_dynamics), jax.jit(pd.inverse_dynamics)
base_forward = jax.jit(pd.base_forward_dynamics)
base_form = jax.jit(lambda p: (pd.base_parameters(p), pd.base_geometry(p)))
torque_parts = jax.jit(
    lambda p, q, v, a: pd.mass_matrix(p, q) @ a + pd.coriolis(p, q, v) + pd.gravity(p, q) + p.damping * v
)


def newton_euler(p, q, v, a):
    """Joint torques by forces on each body; shares nothing with the package but the parameters."""
    m, l, c, I, b = (np.asarray(x, float) for x in (p.mass, p.length, p.com, p.inertia, p.damping))
    J, n, g = np.asarray(p.rotor_inertia, float), np.asarray(p.gear, float), float(p.gravity)
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
    rotor2 = J[1] * (turn[0] + n[1] * a[1])  # spin torque of the rotor that sits on link 1
    rotor1 = J[0] * n[0] * a[0]
    on_link2 = I[1] * turn[1] + cross(arm2, force2)
    on_link1 = I[0] * turn[0] + cross(arm1, m[0] * (com1 + up)) + cross(reach, force2)
    tau2 = on_link2 + n[1] * rotor2 + b[1] * v[1]
    # Virtual work of a turn of joint 1: both links and the second rotor, and the geared first rotor.
    return np.array([on_link1 + on_link2 + rotor2 + n[0] * rotor1 + b[0] * v[0], tau2])


def accelerations(p, q, v, tau):
    """Forward dynamics by probing `newton_euler` with unit accelerations."""
    rest = newton_euler(p, q, v, np.zeros(2))
    M = np.stack([newton_euler(p, q, v, e) - rest for e in np.eye(2)], axis=1)
    return np.linalg.solve(M, tau - rest)


@pytest.mark.parametrize("angle_zero", ["hanging", "upright"])
@pytest.mark.parametrize("rotors", [{}, ROTORS])
def test_dynamics_are_newton_euler(x64, angle_zero, rotors):
    p = pd.rigid_pendulum(**LINKS, **rotors, angle_zero=angle_zero)
    rng = np.random.default_rng(0)
    for q, v, a in rng.normal(size=(20, 3, 2)) * 2:
        tau = newton_euler(p, q, v, a)
        np.testing.assert_allclose(inverse(p, q, v, a), tau, atol=1e-10)
        np.testing.assert_allclose(forward(p, q, v, tau), a, atol=1e-9)
        np.testing.assert_allclose(torque_parts(p, q, v, a), tau, atol=1e-10)


@pytest.mark.parametrize("rotors", [{}, ROTORS])
def test_base_parameters_are_all_that_motion_sees(x64, rotors):
    """Other links with the same base parameters, and the inertial parameters themselves, move alike."""
    p = pd.rigid_pendulum(**LINKS, **rotors)
    m1, m2 = 1.5, 0.6  # other masses; centres and inertias chosen to keep p1, p3, h1, h2
    l1, (c1, c2) = LINKS["length"][0], LINKS["com"]
    h1, h2 = LINKS["mass"][0] * c1 + LINKS["mass"][1] * l1, LINKS["mass"][1] * c2
    com = ((h1 - m2 * l1) / m1, h2 / m2)
    I2 = LINKS["inertia"][1] + LINKS["mass"][1] * c2**2 - m2 * com[1] ** 2
    link1 = LINKS["inertia"][0] + LINKS["mass"][0] * c1**2 + LINKS["mass"][1] * l1**2
    I1 = link1 - m1 * com[0] ** 2 - m2 * l1**2
    assert I1 > 0 and I2 > 0
    other = pd.rigid_pendulum((m1, m2), LINKS["length"], com, (I1, I2), LINKS["damping"], **rotors)
    theta, geometry = base_form(p)
    np.testing.assert_allclose(jax.jit(pd.base_parameters)(other), theta, rtol=1e-12)
    for q, v, tau in np.random.default_rng(1).normal(size=(10, 3, 2)):
        expected = accelerations(p, q, v, tau)
        np.testing.assert_allclose(accelerations(other, q, v, tau), expected, rtol=1e-7)
        np.testing.assert_allclose(base_forward(theta, geometry, q, v, tau), expected, rtol=1e-7)


def test_inverse_dynamics_are_linear_and_independent_in_theta(x64):
    geometry = pd.Geometry(0.8)
    rng = np.random.default_rng(2)

    @jax.jit
    def rows(q, v, a):
        return jax.jacfwd(lambda theta: pd.base_inverse_dynamics(theta, geometry, q, v, a))(jnp.ones(6))

    regressor = np.concatenate([rows(*x) for x in rng.normal(size=(30, 3, 2))])
    assert np.linalg.matrix_rank(regressor) == 6


@pytest.mark.parametrize("angle_zero", ["hanging", "upright"])
def test_simulation_is_what_an_integrator_finds(x64, angle_zero):
    p = pd.rigid_pendulum(**LINKS, **ROTORS, angle_zero=angle_zero)
    plain = jax.tree.map(np.asarray, p)
    dt = np.array([0.01, 0.02, 0.015, 0.01] * 25)  # uneven sampling
    tau = np.random.default_rng(3).normal(size=(100, 2))
    ours = jax.jit(pd.simulate, static_argnums=5)(p, jnp.array([0.4, -0.2]), jnp.zeros(2), tau, dt, 4)
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
    # RK4 at 5 ms: local error about (0.005 * 10 rad/s)^5.
    np.testing.assert_allclose(np.r_[ours.q[-1], ours.v[-1]], x, atol=1e-5)
    assert ours.q.shape == (101, 2) and int(ours.code) == 0


@settings(max_examples=15, deadline=None)
@given(q=st.tuples(*[st.floats(-3, 3)] * 2), v=st.tuples(*[st.floats(-4, 4)] * 2), rotors=st.sampled_from([{}, ROTORS]))
def test_energy_is_kept_without_damping_and_lost_with(q, v, rotors):
    with jax.enable_x64(True):
        for damping in ((0.0, 0.0), (0.1, 0.1)):
            p = pd.rigid_pendulum(**{**LINKS, "damping": damping}, **rotors)
            path = run(p, jnp.asarray(q), jnp.asarray(v))
            change = float(pd.energy(p, path.q[-1], path.v[-1]) - pd.energy(p, path.q[0], path.v[0]))
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
    for m1, m2, b1, b2 in [(1.8, 0.3, 1.5, 1.5), (0.4, 2.6, 1.0, 2.0)]:
        p = pd.rigid_pendulum((m1, m2), (1, 1), (1, 1), (0, 0), (b1, b2), angle_zero=angle_zero)
        for ours, theirs in zip(jax.jit(pd.linearize)(p), linearized(jnp.array([m1, m2, b1, b2])), strict=True):
            np.testing.assert_allclose(ours, theirs, atol=1e-10)


def test_single_precision_batch_and_divergence():
    p = pd.rigid_pendulum(**LINKS)
    starts = jnp.asarray(np.random.default_rng(0).normal(size=(8, 2)), jnp.float32)
    paths = jax.jit(jax.vmap(run, in_axes=(None, 0, 0)))(p, starts, starts)
    assert paths.q.shape == (8, 201, 2) and paths.q.dtype == jnp.float32 and not paths.code.any()
    assert int(run(p, jnp.array([jnp.nan, 0.0]), jnp.zeros(2)).code) == 1


def test_physical_base_parameters_are_told():
    p = pd.rigid_pendulum(**LINKS)
    theta, geometry = base_form(p)
    assert bool(pd.base_is_physical(theta, geometry))
    for name, value in (("p3", -0.1), ("h2", 5.0), ("b1", -0.1), ("p1", 0.01)):
        assert not bool(pd.base_is_physical(theta.at[pd.BASE_NAMES.index(name)].set(value), geometry))


@pytest.mark.parametrize(
    "change, word",
    [
        ({"mass": (1.0, -1.0)}, "mass"),
        ({"length": (0.0, 1.0)}, "length"),
        ({"inertia": (-1e-3, 0.0)}, "inertia"),
        ({"damping": (0.1, float("nan"))}, "damping"),
        ({"com": (0.1,)}, "com"),
        ({"angle_zero": "sideways"}, "angle_zero"),
        ({"gravity": float("inf")}, "gravity"),
    ],
)
def test_unphysical_input_is_refused_by_name(change, word):
    with pytest.raises(BadInput, match=word) as told:
        pd.rigid_pendulum(**{**LINKS, **change})
    assert "\n" not in str(told.value)


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
