"""The maximiser in the box by brute force, targets by hand, and problems whose optimum is known,
trained for real.
"""

from dataclasses import replace
from itertools import product

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.learners.naf import NAFConfig, NAFHyper, Quadratic, box_maximiser, make_naf
from adaptsim_jax.learners.naf_goals import GoalConfig, GoalProblem, make_goal_learner
from adaptsim_jax.learners.replay import Transition


def _random_quadratics(d, count, seed=0):
    rng = np.random.default_rng(seed)
    chol = np.tril(rng.normal(size=(count, d, d)))
    chol[:, np.arange(d), np.arange(d)] = np.exp(rng.uniform(-1.5, 1.5, (count, d)))
    return rng.uniform(-2.5, 2.5, (count, d)), chol


def _by_active_sets(mean, chol):
    """The best feasible point over all assignments of each action to its lower bound, its upper
    bound, or neither.
    """
    P, best, least = chol @ chol.T, None, np.inf
    for held in product((-1.0, 1.0, None), repeat=len(mean)):
        free = [i for i, b in enumerate(held) if b is None]
        at = [i for i, b in enumerate(held) if b is not None]
        a = np.array([0.0 if b is None else b for b in held])
        if free:
            right = P[np.ix_(free, at)] @ (a[at] - mean[at])
            a[free] = mean[free] - np.linalg.solve(P[np.ix_(free, free)], right)
        loss = (a - mean) @ P @ (a - mean)
        if np.all(np.abs(a) <= 1 + 1e-12) and loss < least:
            best, least = a, loss
    return best, least


@pytest.mark.parametrize("d", [1, 2, 3, 4])
def test_box_maximiser_against_all_active_sets(x64, d):
    means, chols = _random_quadratics(d, 300)
    got = np.asarray(jax.jit(box_maximiser)(jnp.asarray(means), jnp.asarray(chols)))
    assert np.abs(got).max() <= 1.0
    for mean, chol, action in zip(means, chols, got, strict=True):
        best, least = _by_active_sets(mean, chol)
        loss = (action - mean) @ chol @ chol.T @ (action - mean)
        assert loss <= least * (1 + 1e-9) + 1e-12, (mean, chol, action, best)


def test_box_maximiser_is_not_a_clip():
    """P = [[1, .9], [.9, 1]] and mean (2, 0): with the first action held at 1, the second is best
    at 0.9.
    """
    chol = jnp.linalg.cholesky(jnp.array([[1.0, 0.9], [0.9, 1.0]]))
    np.testing.assert_allclose(box_maximiser(jnp.array([2.0, 0.0]), chol), [1.0, 0.9], atol=1e-6)


def test_precision_is_full_and_noise_has_its_inverse_as_covariance():
    naf = make_naf(NAFConfig(obs_dim=2, action_dim=2))
    weights = jax.jit(naf.init)(jax.random.key(0)).online * 3.0  # away from the small start
    obs = jnp.array([0.7, -0.4])
    q = naf.quadratic(weights, obs)
    P = np.asarray(q.chol @ q.chol.T)
    assert np.all(np.linalg.eigvalsh(P) > 0) and abs(P[0, 1]) > 1e-3
    acts = jax.jit(jax.vmap(lambda k: naf.act(k, weights, obs, 1e-4)))(
        jax.random.split(jax.random.key(1), 40_000)
    )
    np.testing.assert_allclose(
        np.cov(np.asarray(acts), rowvar=False), 1e-4 * np.linalg.inv(P), rtol=0.05, atol=3e-6
    )


def test_update_by_hand():
    """The first Adam step is the rate times the sign of the gradient, which finite differences give
    as well.
    """
    naf = make_naf(NAFConfig(obs_dim=1, action_dim=2, hidden=(4,), activation="tanh"))
    state = jax.jit(naf.init)(jax.random.key(0))
    rows = jnp.array([[0.3], [-0.8]])
    batch = Transition(
        rows,
        jnp.array([[0.2, -0.5], [0.9, 0.1]]),
        jnp.array([1.0, -1.0]),
        rows[:, :0],
        jnp.zeros(2),
    )
    new, info = jax.jit(naf.update)(state, batch, NAFHyper(learning_rate=1e-2))

    def loss(weights):
        q = naf.quadratic(weights, batch.obs)
        delta = batch.action - q.mean
        P = q.chol @ jnp.swapaxes(q.chol, -1, -2)
        value = q.value - 0.5 * jnp.einsum("bi,bij,bj->b", delta, P, delta)
        error = jnp.abs(value - batch.reward)
        return jnp.mean(jnp.where(error < 1.0, 0.5 * error**2, error - 0.5))

    np.testing.assert_allclose(info.loss, loss(state.online), rtol=1e-5)
    slope = jax.grad(loss)(state.online)
    clear = np.abs(slope) > 1e-4
    np.testing.assert_allclose(
        (new.online - state.online)[clear], -1e-2 * np.sign(slope)[clear], rtol=1e-3
    )


def _train(naf, batch_of, hyper, steps, key):
    """The learning rate falls linearly to 0: at a constant one Adam ends in a cloud about the
    answer.
    """

    def one(state, item):
        number, key = item
        rates = replace(hyper, learning_rate=hyper.learning_rate * (1.0 - number / steps))
        return naf.update(state, batch_of(key), rates)[0], None

    items = (jnp.arange(steps), jax.random.split(key, steps))
    return jax.jit(lambda s, i: jax.lax.scan(one, s, i)[0])(jax.jit(naf.init)(key), items)


def test_a_tilted_quadratic_bandit_is_learned_exactly():
    """r = 1 - (a - m(s))' P (a - m(s)) / 2 with correlated actions: value, mean, precision and the
    bounded best action.
    """
    P = jnp.array([[2.0, 1.2], [1.2, 1.5]])

    def centre(obs):
        return jnp.concatenate([1.2 * obs, -0.5 * obs], -1)

    naf = make_naf(NAFConfig(obs_dim=1, action_dim=2, hidden=(32, 32)))

    def batch(key):
        obs_key, act_key = jax.random.split(key)
        obs = jax.random.uniform(obs_key, (64, 1), minval=-1.0, maxval=1.0)
        action = jax.random.uniform(act_key, (64, 2), minval=-1.0, maxval=1.0)
        delta = action - centre(obs)
        reward = 1.0 - 0.5 * jnp.einsum("bi,ij,bj->b", delta, P, delta)
        return Transition(obs, action, reward, obs[:, :0], jnp.zeros(64))

    state = _train(naf, batch, NAFHyper(3e-3, max_grad_norm=10.0), 4000, jax.random.key(0))
    obs = jnp.linspace(-0.75, 0.75, 13)[
        :, None
    ]  # beyond, the mean lies outside the box, where no data tell it from P
    q = naf.quadratic(state.online, obs)
    np.testing.assert_allclose(q.mean, centre(obs), atol=0.05)
    np.testing.assert_allclose(q.value, 1.0, atol=0.05)
    np.testing.assert_allclose(
        q.chol @ jnp.swapaxes(q.chol, -1, -2), jnp.broadcast_to(P, (13, 2, 2)), atol=0.25
    )
    truth = box_maximiser(centre(obs), jnp.broadcast_to(jnp.linalg.cholesky(P), (13, 2, 2)))
    np.testing.assert_allclose(naf.greedy(state.online, obs), truth, atol=0.05)


# A throw along a line: the outcome is `power * (a0 + 1.2) ** 2` at angle `a1`; its best action is
# known for every goal.
def _throw(context, action):
    reach, angle = context * (action[0] + 1.2) ** 2, 0.6 * action[1]
    return reach * jnp.stack([jnp.cos(angle), jnp.sin(angle)])


def _throw_problem():
    def draw(key):
        reach, angle = jax.random.uniform(
            key, (2,), minval=jnp.array([0.5, -0.4]), maxval=jnp.array([3.0, 0.4])
        )
        return reach * jnp.stack([jnp.cos(angle), jnp.sin(angle)])

    def reward(outcome, goal):
        return jnp.maximum(0.0, 1.0 - jnp.linalg.norm(outcome - goal))

    return GoalProblem(
        draw, lambda goal: goal - jnp.array([1.5, 0.0]), lambda k, c, a: _throw(c, a), reward
    )


def _throw_reward(relabel, rounds=40, policies=4):
    naf, problem = make_naf(NAFConfig(obs_dim=2, action_dim=2)), _throw_problem()
    learner = make_goal_learner(
        naf, problem, GoalConfig(block=20, capacity=800, relabel=relabel), NAFHyper(3e-3)
    )
    power = jnp.linspace(0.8, 1.2, policies)
    goals = jax.vmap(problem.draw)(jax.random.split(jax.random.key(7), 100))

    @jax.jit
    def run(key):
        keys = jax.random.split(key, policies)
        start = jax.vmap(naf.init)(keys).online
        ends = learner.train(keys, start, power, jnp.full(policies, rounds), rounds)

        def act(w, g):
            return naf.greedy(w, problem.see(g))

        def one(w, p):
            return jax.vmap(lambda g: problem.reward(_throw(p, act(w, g)), g))(goals).mean()

        return jax.vmap(one)(start, power), jax.vmap(one)(ends, power)

    return run(jax.random.key(0))


@pytest.mark.slow
def test_relabelled_goals_learn_a_throw_that_unrelabelled_ones_do_not():
    """800 trials and 400 updates a policy. Every goal can be reached, so the optimum is 1."""
    before, relabelled = _throw_reward(1.0)
    _, plain = _throw_reward(0.0)
    assert before.mean() < 0.45
    assert relabelled.mean() > 0.85 and relabelled.mean() > plain.mean() + 0.05


@pytest.mark.slow
def test_together_is_each_alone_and_past_its_rounds_a_policy_rests():
    naf, problem = make_naf(NAFConfig(obs_dim=2, action_dim=2, hidden=(8,))), _throw_problem()
    learner = make_goal_learner(naf, problem, GoalConfig(block=10, updates=2, batch=8, capacity=40))
    keys = jax.random.split(jax.random.key(0), 3)
    start = jax.vmap(naf.init)(keys).online
    power, rounds = jnp.array([0.8, 1.0, 1.2]), jnp.array([4, 2, 0])
    train = jax.jit(learner.train)
    together = train(keys, start, power, rounds, 4)
    for i in range(3):
        alone = train(
            keys[i : i + 1], start[i : i + 1], power[i : i + 1], rounds[i : i + 1], int(rounds[i])
        )
        np.testing.assert_allclose(together[i], alone[0], atol=2e-6)
    assert np.array_equal(together[2], start[2])
    assert not np.allclose(together[1], start[1], atol=1e-4)


def test_hundreds_of_policies_with_their_own_rates_in_one_trace():
    naf = make_naf(NAFConfig(obs_dim=2, action_dim=2, hidden=(8,)))
    chex.clear_trace_counter()
    update = jax.jit(chex.assert_max_traces(lambda s, b, h: jax.vmap(naf.update)(s, b, h), n=1))
    state = jax.jit(jax.vmap(naf.init))(jax.random.split(jax.random.key(0), 300))
    ones = jnp.ones((300, 16, 2))
    batch = Transition(ones, 0.1 * ones, ones[..., 0], ones[..., :0], ones[..., 0])
    for scale in (1.0, 2.0):
        rates = jnp.linspace(0.0, 1e-2, 300) * scale
        hyper = NAFHyper(rates, jnp.ones(300))
        moved = np.abs(np.asarray(update(state, batch, hyper)[0].online - state.online)).max(1)
        np.testing.assert_allclose(moved, rates, rtol=1e-2, atol=1e-7)


def test_quadratic_of_a_known_matrix():
    chol = jnp.array([[2.0, 0.0], [1.0, 3.0]])
    q = Quadratic(jnp.array(5.0), jnp.array([1.0, 2.0]), chol)
    # P = [[4, 2], [2, 10]]; delta = (1, -1): 4 - 4 + 10 = 10
    np.testing.assert_allclose(q(jnp.array([2.0, 1.0])), 5.0 - 0.5 * 10.0)


@pytest.mark.parametrize(
    "bad", [{"obs_dim": 0}, {"action_dim": 0}, {"hidden": ()}, {"activation": "x"}, {"reach": 0.9}]
)
def test_bad_sizes_are_refused(bad):
    with pytest.raises(BadInput):
        make_naf(NAFConfig(**({"obs_dim": 2, "action_dim": 1} | bad)))


@pytest.mark.parametrize(
    "bad", [{"block": 0}, {"near": 1.5}, {"capacity": 150}, {"temperature": 0.0}]
)
def test_bad_training_is_refused(bad):
    with pytest.raises(BadInput):
        make_goal_learner(make_naf(NAFConfig(2, 2)), _throw_problem(), replace(GoalConfig(), **bad))
