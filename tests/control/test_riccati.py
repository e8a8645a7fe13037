"""Riccati solutions against SciPy's, their result codes and their derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg as sl
from hypothesis import given, settings
from hypothesis import strategies as st
from jax.test_util import check_grads

from adaptsim_jax.control.riccati import (
    CONVERGED,
    NOT_FINITE,
    NOT_STABILISING,
    lqr_gain,
    solve_care,
)
from adaptsim_jax.mechanisms.double_pendulum.linear import linearized

SETTINGS = np.array(  # paper, table A2: wd, ood-1 .. ood-4
    [
        [1.8, 1.2, 1.5, 1.5],
        [1.8, 0.3, 1.5, 1.5],
        [0.5, 1.8, 1.5, 1.5],
        [1.2, 1.8, 10, 10],
        [0.4, 2.6, 1, 2],
    ]
)


def random_systems(seed, count, n, m, radius=None):
    rng = np.random.default_rng(seed)
    A, B = rng.normal(size=(count, n, n)), rng.normal(size=(count, n, m))
    if radius is not None:
        A *= radius / np.abs(np.linalg.eigvals(A)).max(axis=1)[:, None, None]
    C, D = rng.normal(size=(count, n, n)), rng.normal(size=(count, m, m))
    return A, B, np.swapaxes(C, 1, 2) @ C, np.swapaxes(D, 1, 2) @ D + 0.1 * np.eye(m)


def pendulum_systems(params):
    A, B = (np.asarray(x) for x in jax.vmap(linearized)(jnp.asarray(params)))
    return A, B, np.tile(np.eye(4), (len(params), 1, 1)), np.tile(np.eye(2), (len(params), 1, 1))


def relative_difference(systems):
    P = np.asarray(jax.jit(jax.vmap(solve_care))(*systems).P)
    reference = np.array(
        [
            sl.solve_continuous_are(*(np.asarray(x, float) for x in s))
            for s in zip(*systems, strict=True)
        ]
    )
    return np.linalg.norm(P - reference, axis=(1, 2)) / np.linalg.norm(reference, axis=(1, 2))


@pytest.mark.slow
@pytest.mark.parametrize("n, m", [(2, 1), (4, 2), (6, 3)])
def test_random_systems_match_scipy_in_double(x64, n, m):
    systems = random_systems(n, 50, n, m)
    # 1e-8 is the project's bar; nearly uncontrollable samples use most of it up, on both sides.
    assert relative_difference(systems).max() < 1e-8


def test_pendulum_settings_match_scipy_in_double(x64):
    assert relative_difference(pendulum_systems(SETTINGS)).max() < 1e-11


@pytest.mark.slow
def test_single_precision_is_usable():
    systems = [x.astype(np.float32) for x in random_systems(3, 50, 4, 2)]
    assert jax.vmap(solve_care)(*systems).P.dtype == jnp.float32
    # Rounding of 1e-7 times the conditioning of these samples, which reaches some hundreds.
    assert relative_difference(systems).max() < 1e-3
    assert relative_difference(pendulum_systems(SETTINGS.astype(np.float32))).max() < 5e-3


def test_codes_say_what_happened():
    unstabilisable = solve_care(
        jnp.diag(jnp.array([1.0, -1.0])), jnp.array([[0.0], [1.0]]), jnp.eye(2), jnp.eye(1)
    )
    undetectable = solve_care(
        jnp.zeros((2, 2)), jnp.eye(2), jnp.diag(jnp.array([1.0, 0.0])), jnp.eye(2)
    )
    broken = solve_care(jnp.full((2, 2), jnp.nan), jnp.eye(2), jnp.eye(2), jnp.eye(2))
    good = solve_care(jnp.zeros((2, 2)), jnp.eye(2), jnp.eye(2), jnp.eye(2))
    assert int(unstabilisable.code) in (NOT_STABILISING, NOT_FINITE)
    assert int(undetectable.code) in (NOT_STABILISING, NOT_FINITE)
    assert int(broken.code) == NOT_FINITE and int(good.code) == CONVERGED
    np.testing.assert_allclose(good.P, np.eye(2), rtol=1e-5)


def test_one_bad_sample_leaves_the_others_alone():
    A, B, Q, R = (jnp.asarray(x, jnp.float32) for x in random_systems(0, 5, 3, 2))
    clean = jax.vmap(solve_care)(A, B, Q, R)
    spoiled = jax.vmap(solve_care)(A.at[2].set(jnp.nan), B, Q, R)
    assert spoiled.code.tolist() == [0, 0, NOT_FINITE, 0, 0]
    keep = np.array([0, 1, 3, 4])
    np.testing.assert_allclose(spoiled.P[keep], clean.P[keep], rtol=1e-5)


def test_nested_vmap_agrees_with_one_at_a_time(x64):
    A, B, Q, R = random_systems(5, 6, 3, 1)
    nested = jax.vmap(jax.vmap(solve_care, in_axes=(0, 0, None, None)), in_axes=(0, 0, 0, None))
    P = nested(A.reshape(2, 3, 3, 3), B.reshape(2, 3, 3, 1), Q[:2], R[0]).P.reshape(6, 3, 3)
    for i in range(6):
        np.testing.assert_allclose(P[i], solve_care(A[i], B[i], Q[i // 3], R[0]).P, rtol=1e-9)


@pytest.mark.slow
def test_derivatives_in_both_modes_and_twice(x64):
    A, B, Q, R = (x[0] for x in random_systems(1, 1, 3, 2, radius=0.9))
    solution = jax.jit(lambda *s: solve_care(*s).P)
    check_grads(solution, (A, B, Q, R), order=2, modes=("fwd", "rev"), rtol=1e-4)


def test_derivatives_under_vmap(x64):
    systems = random_systems(2, 3, 3, 2)

    def size(A, B, Q, R):
        return jnp.sum(solve_care(A, B, Q, R).P ** 2)

    one = jax.jit(jax.grad(size))
    batched = jax.jit(jax.vmap(jax.grad(size)))(*systems)
    for i in range(3):
        np.testing.assert_allclose(batched[i], one(*(x[i] for x in systems)), rtol=1e-8)


def test_gains_place_poles_where_scipy_does(x64):
    A, B, Q, R = (x[0] for x in random_systems(4, 1, 4, 2))
    gain, code = lqr_gain(A, B, Q, R)
    reference = np.linalg.solve(R, B.T @ sl.solve_continuous_are(A, B, Q, R))
    np.testing.assert_allclose(gain, reference, rtol=1e-7)
    assert int(code) == CONVERGED and np.linalg.eigvals(A - B @ np.asarray(gain)).real.max() < 0


@settings(max_examples=60, deadline=None)
@given(a=st.floats(-5, 5), b=st.floats(0.1, 5), q=st.floats(0.01, 100), r=st.floats(0.01, 100))
def test_scalar_equation_has_its_closed_form(a, b, q, r):
    with jax.enable_x64(True):
        P = solve_care(*(jnp.full((1, 1), x) for x in (a, b, q, r))).P[0, 0]
    exact = r * (a + np.sqrt(a * a + b * b * q / r)) / b**2
    if exact > 1e-3 * q:  # below, the textbook formula itself cancels
        assert float(P) == pytest.approx(exact, rel=1e-8)
