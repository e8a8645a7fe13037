"""The linearized pendulum's exact propagation against SciPy's exponential, an integrator and a
plain loop.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg as sl
from hypothesis import given, settings
from hypothesis import strategies as st
from jax.test_util import check_grads
from scipy.integrate import solve_ivp

from adaptsim_jax.mechanisms.double_pendulum import linear as pd
from adaptsim_jax.mechanisms.double_pendulum.linear import (
    COST_CEILING,
    OK,
    OVERFLOW,
    UNSTABLE,
    transition,
)
from tests.mechanisms.linear_trajectory import linear_trajectory

SETTINGS = np.array(  # paper, table A2: wd, ood-1 .. ood-4
    [
        [1.8, 1.2, 1.5, 1.5],
        [1.8, 0.3, 1.5, 1.5],
        [0.5, 1.8, 1.5, 1.5],
        [1.2, 1.8, 10, 10],
        [0.4, 2.6, 1, 2],
    ]
)


def plain_loop(A, B, gain):
    """Cost and all 1000 states, one step at a time, in NumPy."""
    step = sl.expm((A - B @ gain) * 2.5 / 999)
    x, cost, states = np.array([-np.pi, 0, 0, 0]), 0.0, []
    for _ in range(1000):
        u = -gain @ x
        states.append(x)
        cost += x @ x + u @ u
        x = step @ x
    return cost, np.array(states)


def systems(params):
    A, B = (np.asarray(x) for x in pd.linearized(jnp.asarray(params)))
    return A, B, np.asarray(pd.optimal_gain(jnp.clip(jnp.asarray(params), 1.0, 2.0)).gain)


@pytest.mark.parametrize("params", SETTINGS)
@pytest.mark.parametrize("indices", [pd.SNAPSHOTS, pd.LATE_SNAPSHOTS, (0, 1, 999)])
def test_rollout_is_the_plain_loop(x64, params, indices):
    A, B, gain = systems(params)
    cost, states = plain_loop(A, B, gain)
    ours = pd.rollout(jnp.asarray(params), gain, indices)
    assert float(ours.cost) == pytest.approx(cost, rel=1e-11) and int(ours.code) == OK
    np.testing.assert_allclose(ours.points, states[list(indices)], atol=1e-10)


def test_rollout_is_what_an_integrator_finds(x64):
    A, B, gain = systems(SETTINGS[1])
    times = np.linspace(0, 2.5, 1000)
    flow = solve_ivp(
        lambda _, x: (A - B @ gain) @ x,
        (0, 2.5),
        [-np.pi, 0, 0, 0],
        t_eval=times,
        rtol=1e-10,
        atol=1e-12,
    )
    states, commands = linear_trajectory(A, B, gain, jnp.asarray(pd.START), jnp.asarray(times))
    np.testing.assert_allclose(states, flow.y.T, atol=1e-7)
    cost = np.sum(np.asarray(states) ** 2) + np.sum(np.asarray(commands) ** 2)
    assert float(pd.rollout(SETTINGS[1], gain).cost) == pytest.approx(cost, rel=1e-11)


def test_known_optimal_costs(x64):
    """Costs of the release at equal parameters, three digits: an anchor outside this code."""
    for value, cost in ((1.0, 3.30e6), (1.5, 7.42e6), (2.0, 13.2e6)):
        params = jnp.full(4, value)
        assert float(pd.rollout(params, pd.optimal_gain(params).gain).cost) == pytest.approx(
            cost, rel=4e-3
        )


def both(params, nominal):
    return pd.rollout(params, pd.optimal_gain(nominal).gain)


@pytest.mark.slow
def test_single_precision_is_good_enough_for_rewards():
    """The reward is 1 - 10 (J/J* - 1): 1e-4 of cost is 1e-3 of reward. Gains here come from inside
    the box.
    """
    rng = np.random.default_rng(0)
    params = np.concatenate([SETTINGS, rng.uniform(1, 2, (295, 4))])
    nominal = np.clip(params, 1, 2)
    single = jax.jit(jax.vmap(both))(
        jnp.asarray(params, jnp.float32), jnp.asarray(nominal, jnp.float32)
    )
    with jax.enable_x64(True):
        double = jax.jit(jax.vmap(both))(params, nominal)
    assert single.cost.dtype == jnp.float32 and double.cost.dtype == jnp.float64
    assert np.abs(np.asarray(single.cost) / np.asarray(double.cost) - 1).max() < 1e-4
    np.testing.assert_allclose(single.points, double.points, atol=5e-3)


def test_unstable_and_overflowing_loops_are_told_not_nan():
    params = jnp.asarray(SETTINGS[0], jnp.float32)
    falls = pd.rollout(params, jnp.zeros((2, 4)))
    assert int(falls.code) == UNSTABLE and falls.cost < COST_CEILING
    for gain in (jnp.full((2, 4), -1e3), jnp.full((2, 4), -1e30), jnp.full((2, 4), jnp.nan)):
        wild = pd.rollout(params, gain)
        assert int(wild.code) == OVERFLOW and float(wild.cost) == pytest.approx(COST_CEILING)
        assert np.all(np.isfinite(wild.points))


@pytest.mark.slow
def test_gradients_through_riccati_and_rollout(x64):
    target = jnp.asarray(SETTINGS[1])
    cost = jax.jit(lambda nominal: both(target, nominal).cost / 1e6)
    check_grads(cost, (jnp.full(4, 1.5),), order=1, rtol=1e-5)
    points = jax.jit(lambda params: both(params, jnp.full(4, 1.5)).points)
    check_grads(points, (target,), order=1, rtol=1e-5)
    batch = jax.jit(jax.vmap(jax.grad(cost)))(jnp.array([[1.0] * 4, [1.5] * 4]))
    np.testing.assert_allclose(batch[1], jax.jit(jax.grad(cost))(jnp.full(4, 1.5)), rtol=1e-8)


def test_late_snapshots_are_the_last_half_second():
    times = np.array(pd.LATE_SNAPSHOTS) * 2.5 / 999
    assert (
        len(times) == 12
        and times[0] == pytest.approx(2.0, abs=2e-3)
        and times[-1] == pytest.approx(2.5)
    )


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), size=st.floats(1e-6, 30))
def test_transition_is_the_matrix_exponential(seed, size):
    X = np.random.default_rng(seed).normal(size=(4, 4))
    X *= size / np.linalg.norm(X)
    with jax.enable_x64(True):
        ours, exact = np.asarray(jax.jit(transition)(X, 1.0)), sl.expm(X)
    # A Taylor series of 8 terms at norm 1/2 leaves 1e-8, doubled by each squaring.
    assert np.linalg.norm(ours - exact) < 3e-8 * max(1.0, size) * max(np.linalg.norm(exact), 1.0)
