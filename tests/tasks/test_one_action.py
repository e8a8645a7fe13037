"""A task whose policy is one action, as the baselines see it."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax import BadInput, Parameter, Space, Task
from adaptsim_jax.tasks.one_action import one_action

SPACE = Space((Parameter("gain", 0.5, 2.0, "1"),))


def FLIP(key, policy, params):
    return params * policy + 0.01 * jax.random.normal(key)


LAUNCHER = Task(
    name="launcher",
    space=SPACE,
    targets=SPACE,
    obs_dim=1,
    settings={"weak": {"gain": 0.6}},
    init_policy=lambda key: jnp.zeros(1),
    train=lambda key, dist, policy: 3.0 / SPACE.physical(dist.mean),
    rollout=FLIP,
    observe=lambda at: at,
    score=lambda at: -jnp.abs(at[0] - 3.0),
    reference=lambda params: params[0],
    reward=lambda at, gain: 1.0 - jnp.abs(at[0] - 3.0) / gain,
)
KEY = jax.random.key(0)


@pytest.fixture(scope="module")
def one():
    return one_action(LAUNCHER, [0.0], [8.0], tests=2, points=21)


def test_actions_span_the_bounds_and_trials_have_luck_of_their_own(one):
    contexts = jnp.stack([one.draw(k) for k in jax.random.split(KEY, 3)])
    assert one.act(jnp.array([8.0]), contexts).tolist() == [[1.0]] * 3
    assert (
        one.act(jnp.array([4.0]), contexts).tolist() == [[0.0]] * 3
        and one.act(jnp.array([99.0]), contexts).max() == 1.0
    )
    noisy = one.explore(KEY, jnp.array([7.9]), contexts)
    assert noisy.shape == (3, 1) and float(noisy.max()) <= 1.0
    outcomes, codes = one.world("own").run(np.ones((3, 1)), np.asarray(contexts), np.zeros((3, 1)))
    assert len(set(np.asarray(outcomes[0]).ravel().tolist())) == 3 and codes.tolist() == [0, 0, 0]
    again, _ = one.world("own").run(np.ones((3, 1)), np.asarray(contexts), np.zeros((3, 1)))
    np.testing.assert_array_equal(again[0], outcomes[0])


def test_rewards_are_scaled_by_the_target_and_a_failure_earns_nothing(one):
    world = one.world("own")
    contexts = np.asarray(one.tests)
    outcomes, codes = world.run(np.array([[0.6], [np.nan]]), contexts, np.full((2, 1), 0.25))
    rewards = jax.vmap(one.reward)(outcomes, contexts)
    assert (
        float(rewards[0]) == pytest.approx(1.0, abs=0.1)
        and rewards[1] == 0.0
        and codes.tolist() == [0, 1]
    )
    assert np.mean(one.oracle(world, np.array([0.6]))) > 0.97


def test_one_policy_serves_all_of_omega_and_the_best_trial_is_kept(one):
    assert 1.5 < float(one.train_uniform(KEY)[0]) < 6.0
    actions = jnp.array([[-0.9], [0.25], [0.9]])
    outcomes, _ = one.world("own").run(
        np.full((3, 1), 0.6), np.tile(one.tests[:1], (3, 1)), np.asarray(actions)
    )

    def tune(used):
        return float(one.tune(KEY, jnp.array([7.0]), None, actions, outcomes, jnp.asarray(used))[0])

    assert [tune(n) for n in (0, 1, 3)] == pytest.approx([7.0, 0.4, 5.0])


def test_what_is_no_single_action_or_no_engine_is_told(one):
    for low, high in (([0.0], [0.0]), ([0.0, 0.0], [1.0])):
        with pytest.raises(BadInput, match="bound no actions"):
            one_action(LAUNCHER, low, high)
    two = replace(LAUNCHER, init_policy=lambda key: (jnp.zeros(1), jnp.zeros(3)))
    with pytest.raises(BadInput, match=r"shapes \(1,\), \(3,\)"):
        one_action(two, [0.0], [1.0])
    with pytest.raises(BadInput, match="leave target out"):
        one.world("drake")
