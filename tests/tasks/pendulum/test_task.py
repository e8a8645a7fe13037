import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_are

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.space import gaussian
from adaptsim_jax.tasks.pendulum.task import SETTINGS, PendulumConfig, make_pendulum
from adaptsim_jax.tasks.registry import make_task


def _world(params):
    """The linearized pendulum from its mass matrix (independent of `models/`): A, B."""
    m1, m2, b1, b2 = params
    mass = np.array([[m1 + 4 * m2, 2 * m2], [2 * m2, m2]])
    # potential energy of two point masses on unit links, to second order about upright
    stiffness = 9.81 * np.array([[m1 + 2 * m2, m2], [m2, m2]])
    lower = np.linalg.solve(mass, np.hstack([stiffness, -np.diag([b1, b2])]))
    return np.vstack([np.hstack([np.zeros((2, 2)), np.eye(2)]), lower]), np.vstack(
        [np.zeros((2, 2)), np.linalg.inv(mass)]
    )


def _gain(params):
    A, B = _world(params)
    return B.T @ solve_continuous_are(A, B, np.eye(4), np.eye(2))


def _simulate(params, gain):
    A, B = _world(params)
    step = expm((A - B @ gain) * 2.5 / 999)
    states = [np.array([-np.pi, 0, 0, 0])]
    for _ in range(999):
        states.append(step @ states[-1])
    states = np.array(states)
    return states, np.sum(states**2) + np.sum((states @ gain.T) ** 2)


@pytest.mark.slow
@pytest.mark.parametrize("name", SETTINGS)
def test_reward_and_observation_against_scipy(name):
    task = make_pendulum(PendulumConfig(scaling="paper", reference="optimum"))
    target = task.space.values(SETTINGS[name])
    mean = np.array([1.3, 1.8, 1.1, 1.6])

    @jax.jit
    def run(mean, target):
        policy = task.train(jax.random.key(0), gaussian(task.space, task.space.unit(mean)), None)
        trajectory = task.rollout(jax.random.key(0), policy, target)
        reward = task.reward(trajectory, task.reference(target))
        return task.observe(trajectory), task.score(trajectory), reward

    obs, score, reward = run(jnp.asarray(mean, jnp.float32), jnp.asarray(target, jnp.float32))
    states, cost = _simulate(target, _gain(mean))
    _, best = _simulate(target, _gain(target))
    points = states[81:973:81, :2]
    want = np.stack([(points[:, 0] + np.pi) / np.pi, points[:, 1]], -1).reshape(-1)
    # single precision against double through a gain of norm 100: the reward's gain of 10 makes 1e-4
    # here 1e-3 there
    np.testing.assert_allclose(score, -cost, rtol=1e-4)
    np.testing.assert_allclose(obs, want, atol=2e-4)
    np.testing.assert_allclose(reward, 1 - 10 * (cost / best - 1), atol=2e-3)


def test_settings_are_those_of_table_a2():
    table = np.array([[*s.values()] for s in SETTINGS.values()])
    np.testing.assert_array_equal(
        table,
        [
            [1.8, 1.2, 1.5, 1.5],
            [1.8, 0.3, 1.5, 1.5],
            [0.5, 1.8, 1.5, 1.5],
            [1.2, 1.8, 10, 10],
            [0.4, 2.6, 1, 2],
        ],
    )


@pytest.mark.slow
def test_best_in_omega_against_a_dense_grid():
    """Rewards are scaled by a quick search; here it is held against 9^4 means for wide targets."""
    task = make_pendulum(PendulumConfig(reference="omega"))
    targets = task.targets.physical(task.targets.sample(jax.random.key(1), (40,)))
    quick = jax.jit(jax.vmap(task.reference))(targets)
    line = jnp.linspace(0, 1, 9)
    grid = jnp.stack(jnp.meshgrid(*[line] * 4, indexing="ij"), -1).reshape(-1, 4)
    policies = jax.jit(jax.vmap(lambda u: task.train(None, gaussian(task.space, u), None)))(grid)
    costs = jax.jit(
        lambda ts: jax.lax.map(
            lambda t: jax.vmap(lambda p: -task.score(task.rollout(None, p, t)))(policies).min(), ts
        )
    )(targets)
    ratio = np.asarray(quick / costs)
    assert np.median(ratio) < 1.0002 and np.quantile(ratio, 0.95) < 1.004 and ratio.max() < 1.02


def test_observations_are_finite_where_the_loop_diverges():
    task = make_pendulum(PendulumConfig(scaling="whitened"))
    target = jnp.array([0.05, 5.0, 0.0, 0.0])
    policy = task.train(None, gaussian(task.space, jnp.zeros(4)), None)
    trajectory = task.rollout(None, policy, target)
    assert trajectory.code != 0
    assert np.all(np.isfinite(task.observe(trajectory))) and np.isfinite(task.score(trajectory))


@pytest.mark.slow
@pytest.mark.parametrize("observation", ["full", "late"])
def test_whitened_observations_have_unit_spread_before_compression(observation):
    task = make_pendulum(PendulumConfig(scaling="whitened", observation=observation, components=8))
    keys = jax.random.split(jax.random.key(5), 2)
    sims, targets = (
        task.space.sample(keys[0], (2000,)),
        task.space.physical(task.space.sample(keys[1], (2000,))),
    )

    @jax.jit
    @jax.vmap
    def observe(u, target):
        policy = task.train(None, gaussian(task.space, u), None)
        return task.observe(task.rollout(None, policy, target))

    seen = np.asarray(observe(sims, targets))
    plain = np.sign(seen) * np.expm1(np.abs(seen))
    # both this sample of 2000 and the 4000 that the scale came from; late points have heavy tails,
    # so by their kurtosis
    kurtosis = np.mean((plain - plain.mean(0)) ** 4, 0) / plain.var(0) ** 2
    error = np.sqrt((kurtosis - 1) / 4 * (1 / 2000 + 1 / 4000))
    assert np.all(np.abs(plain.std(0) - 1) < 5 * error) and np.all(error < 0.1)
    if (
        observation == "full"
    ):  # the late points' tails make sample correlations too noisy to say anything
        np.testing.assert_allclose(np.corrcoef(plain.T), np.eye(8), atol=0.15)


def test_unknown_task_or_option_names_the_nearest():
    with pytest.raises(BadInput, match="pendulum"):
        make_task("pendulm", {})
    with pytest.raises(BadInput, match="did you mean 'reward_gain'"):
        make_task("pendulum", {"reward_gian": 3.0})
    with pytest.raises(BadInput, match="components"):
        make_task("pendulum", {"components": 99})
