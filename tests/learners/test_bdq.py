"""Targets worked out by hand, gradients by finite differences, and problems whose Q-values are
known.
"""

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.learners.bdq import (
    BDQConfig,
    BDQHyper,
    BDQState,
    double_q_target,
    explore,
    held,
    make_bdq,
)
from adaptsim_jax.learners.replay import Transition


def test_dueling_advantages_average_to_the_value():
    bdq = make_bdq(BDQConfig(obs_dim=5, branches=3))
    q = bdq.q_values(
        jax.jit(bdq.init)(jax.random.key(0)).online, jax.random.normal(jax.random.key(1), (7, 5))
    )
    assert q.shape == (7, 3, 3)
    means = q.mean(-1)
    np.testing.assert_allclose(means, np.broadcast_to(means[:, :1], means.shape), atol=1e-6)


def test_double_q_target_by_hand():
    """Two branches of three bins; the online tables choose bins 2 and 0, the target tables value
    them 5 and 1.
    """
    online = jnp.array([[[0.0, 1.0, 2.0], [9.0, 8.0, 7.0]]])
    target = jnp.array([[[50.0, 50.0, 5.0], [1.0, 50.0, 50.0]]])
    state = BDQState(online, target, optax.EmptyState())
    batch = Transition(
        jnp.zeros((2, 1)),
        jnp.zeros((2, 2), jnp.int32),
        jnp.array([1.0, 1.0]),
        jnp.zeros((2, 1)),
        jnp.array([1.0, 0.0]),
    )
    got = double_q_target(lambda table, obs: jnp.broadcast_to(table, (2, 2, 3)), state, batch, 0.9)
    # r + 0.9 * (5 + 1) / 2, and the reward alone where nothing follows
    np.testing.assert_allclose(got, [1.0 + 0.9 * 3.0, 1.0], rtol=1e-6)


def test_target_moves_by_tau_and_step_is_bounded_by_the_rate():
    bdq = make_bdq(BDQConfig(obs_dim=2, branches=1, hidden=(8,)))
    state = jax.jit(bdq.init)(jax.random.key(0))
    batch = Transition(
        jnp.ones((4, 2)),
        jnp.zeros((4, 1), jnp.int32),
        jnp.full(4, 100.0),
        jnp.ones((4, 2)),
        jnp.zeros(4),
    )
    new, info = jax.jit(bdq.update)(state, batch, BDQHyper(learning_rate=1e-2, tau=0.25))
    # Adam's first step is the rate times the sign of the gradient
    moved = np.asarray(new.online - state.online)
    assert np.abs(moved).max() <= 1e-2 * (1 + 1e-3) and np.abs(moved).max() > 9e-3
    np.testing.assert_allclose(new.target - state.target, 0.25 * moved, atol=1e-6)
    assert info.grad_norm > 1.0


def test_clipping_keeps_the_direction_of_the_gradient():
    """Adam is blind to the scale of a constant gradient, so compare its first moment."""
    bdq = make_bdq(BDQConfig(obs_dim=2, branches=1, hidden=(8,)))
    state = jax.jit(bdq.init)(jax.random.key(0))
    batch = Transition(
        jnp.ones((4, 2)),
        jnp.zeros((4, 1), jnp.int32),
        jnp.full(4, 100.0),
        jnp.ones((4, 2)),
        jnp.zeros(4),
    )
    clipped, info = jax.jit(bdq.update)(state, batch, BDQHyper(max_grad_norm=1.0))
    free, _ = jax.jit(bdq.update)(state, batch, BDQHyper(max_grad_norm=1e9))
    np.testing.assert_allclose(np.linalg.norm(clipped.opt.mu), 0.1, rtol=1e-4)
    np.testing.assert_allclose(clipped.opt.mu * info.grad_norm, free.opt.mu, rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("independent", [0.0, 1.0])
def test_exploration_replaces_whole_actions_or_single_branches(independent):
    action = jnp.full((20_000, 2), 5, jnp.int32)
    changed = np.asarray(explore(jax.random.key(0), action, 3, 0.5, independent)) != 5
    assert abs(changed.mean() - 0.5) < 0.02
    together = np.mean(changed[:, 0] == changed[:, 1])
    assert together == 1.0 if not independent else abs(together - 0.5) < 0.02


def _learn(bdq, batch_of, hyper, steps, key):
    """Train on batches drawn by `batch_of(key)`; return the online weights."""

    def one(state, key):
        return bdq.update(state, batch_of(key), hyper)[0], None

    run = jax.jit(lambda s, k: jax.lax.scan(one, s, jax.random.split(k, steps))[0])
    return run(jax.jit(bdq.init)(key), key)


def test_bandit_learns_each_branch_mean():
    """One step, no observation: Q of a branch is the mean reward over the other branch's uniform
    actions.
    """
    table = jnp.array([[0.0, 1.0, 2.0], [3.0, -1.0, 1.0], [0.5, 0.0, -2.0]])
    bdq = make_bdq(BDQConfig(obs_dim=1, branches=2, hidden=(16,)))

    def batch(key):
        action = jax.random.randint(key, (64, 2), 0, 3)
        obs = jnp.ones((64, 1))
        return Transition(obs, action, table[action[:, 0], action[:, 1]], obs, jnp.zeros(64))

    state = _learn(
        bdq, batch, BDQHyper(learning_rate=3e-3, max_grad_norm=10.0), 3000, jax.random.key(0)
    )
    q = bdq.q_values(state.target, jnp.ones(1))
    # Dueling with a shared value fits an additive table: both branches average to the same mean, so
    # this is exact.
    np.testing.assert_allclose(q[0], table.mean(1), atol=0.12)
    np.testing.assert_allclose(q[1], table.mean(0), atol=0.12)


def test_chain_learns_discounted_values():
    """Five states in a row, right end pays 1 and ends; left, right, stay. V(s) = discount^(4 - s -
    1).
    """
    n, discount = 5, 0.8
    bdq = make_bdq(BDQConfig(obs_dim=n, branches=1, hidden=(32,)))

    def batch(key):
        place_key, action_key = jax.random.split(key)
        place = jax.random.randint(place_key, (64,), 0, n - 1)
        action = jax.random.randint(action_key, (64, 1), 0, 3)
        after = jnp.clip(place + jnp.array([-1, 1, 0])[action[:, 0]], 0, n - 1)
        done = (after == n - 1).astype(jnp.float32)
        return Transition(
            jax.nn.one_hot(place, n), action, done, jax.nn.one_hot(after, n), 1 - done
        )

    hyper = BDQHyper(learning_rate=3e-3, discount=discount, tau=0.02)
    state = _learn(bdq, batch, hyper, 4000, jax.random.key(2))
    q = np.asarray(bdq.q_values(state.target, jnp.eye(n)))[:-1, 0]
    value = discount ** np.arange(n - 2, -1, -1)
    left = discount * np.concatenate([value[:1], value[:-1]])
    np.testing.assert_allclose(q, np.stack([left, value, discount * value], -1), atol=0.03)


def test_rates_are_traced():
    traces = []
    bdq = make_bdq(BDQConfig(obs_dim=2, branches=1, hidden=(4,)))
    batch = Transition(
        jnp.ones((4, 2)), jnp.zeros((4, 1), jnp.int32), jnp.ones(4), jnp.ones((4, 2)), jnp.zeros(4)
    )

    @jax.jit
    def update(state, hyper):
        traces.append(1)
        return bdq.update(state, batch, hyper)

    for rate in (1e-3, 1e-2, 1e-1):
        update(
            jax.jit(bdq.init)(jax.random.key(0)),
            jax.tree.map(jnp.float32, BDQHyper(learning_rate=rate)),
        )
    assert len(traces) == 1


@pytest.mark.parametrize(
    "bad", [{"obs_dim": 0}, {"branches": 0}, {"bins": 1}, {"hidden": ()}, {"activation": "x"}]
)
def test_bad_sizes_are_refused(bad):
    with pytest.raises(BadInput):
        make_bdq(BDQConfig(**({"obs_dim": 2, "branches": 1} | bad)))


def test_what_is_held_at_a_bound_has_a_gradient_that_leads_back():
    x = jnp.array([-4.0, 0.0, 4.0])
    for way, wanted in ((1.0, [0.0, 1.0, 1.0]), (-1.0, [-1.0, -1.0, 0.0])):
        value, slope = jax.value_and_grad(lambda x, way=way: way * held(x, -3.0, 3.0).sum())(x)
        assert value == 0.0
        np.testing.assert_array_equal(slope, wanted)
