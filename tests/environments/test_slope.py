"""d(return)/d(E's mean) through the policy: against finite differences; truncated where it
explodes.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.environments.episodes import make_slope
from adaptsim_jax.environments.policies import Law, acting_of
from adaptsim_jax.environments.setting import EnvironmentConfig, setting_of
from adaptsim_jax.environments.trainer import PPOTraining
from tests.environments import small
from tests.environments.cart import Cart

CONFIG = EnvironmentConfig(training=PPOTraining(steps=800, parallel=32, unroll=25, hidden=(16,)))
KEYS = jax.random.split(jax.random.key(5), 2)


def made(env, values=None):
    setting = setting_of(env, CONFIG)
    learned = setting.trainer.init(jax.random.key(0))
    learned = learned._replace(
        weights=0.3 * jax.random.normal(jax.random.key(1), learned.weights.shape)
    )
    acting = acting_of(setting, learned)
    values = jnp.asarray(
        [f.nominal for f in setting.fields] if values is None else values, jnp.float32
    )
    return setting, acting, values


def by_differences(setting, acting, values, mean, by=3e-3):
    @jax.jit
    @jax.vmap
    def score(mean):
        def one(key):
            play, world = setting.play, setting.play.world(values)
            reset_key, act_key = jax.random.split(key)

            def step(live, key):
                action, _ = acting.act(key, Law(mean), (), live)
                live = play.step(world, live, action)
                return live, live.reward

            return jax.lax.scan(
                step, play.reset(world, reset_key), jax.random.split(act_key, play.sim.length)
            )[1].sum()

        return jax.vmap(one)(KEYS).mean()

    moves = by * np.eye(len(mean))
    up, down = (
        np.asarray(score(jnp.asarray(mean + s * moves, jnp.float32)), np.float64) for s in (1, -1)
    )
    return (up - down) / (2 * by)


@pytest.mark.parametrize("env", [Cart, pytest.param(small.make, marks=pytest.mark.slow)])
def test_it_agrees_with_finite_differences(env):
    setting, acting, values = made(env())
    mean = np.array([0.4, 0.6])
    found = make_slope(setting.play, acting, Law)(KEYS, mean, values)
    expected = by_differences(setting, acting, values, mean)
    assert np.abs(expected).max() > 0.02 and found.window == setting.sim.length
    np.testing.assert_allclose(
        found.gradient, expected, rtol=0.03, atol=0.01 * np.abs(expected).max()
    )


class Unstable(Cart):
    """It is driven away from the middle, and worth the more the nearer it is to a place far out."""

    def reward(self, state):
        return 1.0 + jnp.sin(50.0 * state.place)


def test_it_is_truncated_where_it_explodes_and_says_so():
    setting, acting, values = made(Unstable(), [0.5, -8.0])  # damping below 0 pushes on
    found = make_slope(setting.play, acting, Law)(KEYS, np.array([0.5, 0.5]), values)
    assert 0 < found.window < setting.sim.length and np.isfinite(found.gradient).all()
