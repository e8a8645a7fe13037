"""PPO: advantages as the definition says, standardisation as NumPy does it, and that it learns what
is best.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.learners.ppo import (
    HIGHEST,
    LOWEST,
    PPOConfig,
    PPOHyper,
    Unroll,
    _shuffled,
    carried,
    gae,
    make_ppo,
)

T, B = 6, 4


def batch_of(rng, **changed):
    def f(*shape):
        return jnp.asarray(rng.normal(size=shape), jnp.float32)

    zeros = jnp.zeros((T, B))
    rows = {
        "obs": f(T, B, 3),
        "extra": f(T, B, 2),
        "action": f(T, B, 1),
        "log_prob": f(T, B),
        "reward": f(T, B),
        "after": f(T, B, 3),
        "ended": zeros,
        "cut": zeros,
        "carried": jnp.zeros(B),
    }
    return Unroll(**rows | changed)


def test_advantages_are_the_discounted_sums_of_surprises():
    rng = np.random.default_rng(0)
    ended, cut = np.zeros((T, B)), np.zeros((T, B))
    ended[2, 0] = cut[3, 1] = 1.0
    batch = batch_of(rng, ended=jnp.asarray(ended, jnp.float32), cut=jnp.asarray(cut, jnp.float32))
    value, after = rng.normal(size=(2, T, B)).astype(np.float32)
    hyper = PPOHyper(discount=0.9, trace=0.8)
    found = np.asarray(gae(batch.reward, value, jnp.asarray(after), batch, hyper))
    wanted = np.zeros((T, B))
    for b in range(B):
        for t in range(T):
            for k in range(t, T):
                surprise = batch.reward[k, b] + 0.9 * (1 - ended[k, b]) * after[k, b] - value[k, b]
                wanted[t, b] += (0.9 * 0.8) ** (k - t) * surprise
                if ended[k, b] or cut[k, b]:  # nothing behind it belongs to this episode
                    break
    np.testing.assert_allclose(found, wanted, atol=1e-5)


def test_discounted_rewards_are_carried_from_batch_to_batch_within_an_episode():
    reward = jnp.ones((T, B))
    cut = jnp.zeros((T, B)).at[1, 0].set(1.0)
    every, rest = carried(
        batch_of(np.random.default_rng(0), reward=reward, cut=cut, carried=jnp.full(B, 2.0)), 0.5
    )
    np.testing.assert_allclose(every[:3, 0], [2.0, 2.0, 1.0])
    np.testing.assert_allclose(rest[1:], 2.0)  # 2 is where it stays


def test_rows_are_shuffled_so_that_each_is_as_likely_in_each_minibatch():
    keys = jax.random.split(jax.random.key(3), 4000)
    orders = np.asarray(jax.jit(jax.vmap(lambda k: _shuffled(k, 12)))(keys))
    assert np.all(np.sort(orders, 1) == np.arange(12))
    parts = np.argsort(orders, 1) // 4  # the minibatch of each row, three of four rows each
    shares = np.stack([(parts == m).mean(0) for m in range(3)])
    assert np.all(np.abs(shares - 1 / 3) < 5 * np.sqrt(2 / 9 / 4000))
    together = np.mean(parts[:, 0] == parts[:, 1])  # 3 of the 11 others share a row's minibatch
    assert abs(together - 3 / 11) < 5 * np.sqrt(3 / 11 * 8 / 11 / 4000)
    assert (
        np.all(np.sort(_shuffled(keys[0], 1)) == [0])
        and len(np.unique(_shuffled(keys[0], 10240))) == 10240
    )


def test_what_was_seen_is_standardised_as_all_of_it_at_once():
    ppo, rng = make_ppo(PPOConfig(3, 1, 2, (8,), epochs=1, minibatches=2)), np.random.default_rng(1)
    state, batches = (
        ppo.init(jax.random.key(0)),
        [
            batch_of(rng, obs=jnp.asarray(rng.normal(3.0, 2.0, (T, B, 3)), jnp.float32))
            for _ in range(3)
        ],
    )
    for batch in batches:
        state, _ = jax.jit(ppo.update)(jax.random.key(1), state, batch, PPOHyper())
    seen = np.concatenate([np.asarray(b.obs).reshape(-1, 3) for b in batches])
    actor = ppo.actor(state)
    np.testing.assert_allclose(actor.mean, seen.mean(0), rtol=1e-4)
    np.testing.assert_allclose(actor.std, seen.std(0), rtol=1e-3)


@pytest.mark.parametrize(("entropy", "end"), [(1.0, HIGHEST), (-1.0, LOWEST)])
def test_exploration_that_reached_its_bound_comes_back(entropy, end):
    ppo = make_ppo(PPOConfig(3, 1, 2, (8,), epochs=4, minibatches=2))
    rates = PPOHyper(learning_rate=0.02, entropy=entropy)
    update, rng = jax.jit(ppo.update), np.random.default_rng(1)
    state, flat = ppo.init(jax.random.key(0)), jnp.zeros((T, B))
    spreads = []
    for i in range(80):
        if i == 40:  # what is wanted of it is turned round
            rates = replace(rates, entropy=-entropy)
        key = jax.random.key(i)
        batch = batch_of(rng, reward=flat)
        action, log_prob = ppo.act(key, ppo.actor(state), batch.obs, batch.extra)
        batch = batch._replace(action=action, log_prob=log_prob)
        state, info = update(key, state, batch, rates)
        spreads.append(float(jnp.log(info.spread)))
    assert spreads[39] == pytest.approx(end, abs=1e-3)
    assert abs(spreads[-1] - end) > 1.0


@pytest.mark.parametrize("when", [0, 2])
def test_a_world_that_blows_up_does_not_hide_what_others_show(when):
    ppo, rng = make_ppo(PPOConfig(3, 1, 2, (8,), epochs=1, minibatches=2)), np.random.default_rng(1)
    obs, zeros = (
        lambda: jnp.asarray(rng.normal(3.0, 2.0, (T, 64, 3)), jnp.float32),
        jnp.zeros((T, 64)),
    )
    rest = Unroll(
        obs(), jnp.zeros((T, 64, 2)), zeros[..., None], zeros, zeros, obs(), zeros, zeros, zeros[0]
    )
    usual = [rest._replace(obs=obs(), reward=obs()[..., 0]) for _ in range(3)]
    far = usual[when]._replace(
        obs=usual[when].obs.at[3, 5, 1].set(1e27), reward=usual[when].reward.at[3, 5].set(-1e30)
    )
    found = []
    for batches in (usual, [*usual[:when], far, *usual[when + 1 :]]):
        state = ppo.init(jax.random.key(0))
        for batch in batches:
            state, info = jax.jit(ppo.update)(jax.random.key(1), state, batch, PPOHyper())
        found.append(ppo.actor(state))
    assert np.all(np.isfinite(found[1].weights)) and np.isfinite(info.value_loss)
    np.testing.assert_allclose(found[1].mean, found[0].mean, atol=0.5)
    assert np.all(
        found[1].std < 4.5 * found[0].std
    )  # of 2 in 1,152 numbers, where nothing is done 1e25


def test_what_is_rare_but_comes_again_is_standardised_in_the_end():
    ppo, rng = make_ppo(PPOConfig(3, 1, 2, (8,), epochs=1, minibatches=2)), np.random.default_rng(1)
    state, update = ppo.init(jax.random.key(0)), jax.jit(ppo.update)
    for _ in range(30):
        obs = rng.normal(size=(T, B, 3))
        obs[..., 0] = 5e3 * (rng.random((T, B)) < 0.03)  # a force, where anything touches
        state, _ = update(
            jax.random.key(1), state, batch_of(rng, obs=jnp.asarray(obs, jnp.float32)), PPOHyper()
        )
    assert 500.0 < ppo.actor(state).std[0] < 1100.0


def test_it_finds_the_best_action_for_what_it_is_told():
    """A single step worth 1 - (action - told)^2: told 0.6 or -0.6, a policy that cannot read it
    earns 0.64.
    """
    ppo = make_ppo(PPOConfig(1, 1, 1, (16,), epochs=4, minibatches=4))
    told = jnp.where(jnp.arange(128) % 2 == 0, 0.6, -0.6)[None, :, None]
    obs = jnp.ones((1, 128, 1))

    @jax.jit
    def learn(key, state):
        def one(state, key):
            act_key, update_key = jax.random.split(key)
            action, log_prob = ppo.act(act_key, ppo.actor(state), obs, told)
            reward = 1.0 - jnp.square(action - told)[..., 0]
            one, zero = jnp.ones((1, 128)), jnp.zeros((1, 128))
            batch = Unroll(obs, told, action, log_prob, reward, obs, one, zero, jnp.zeros(128))
            return ppo.update(update_key, state, batch, PPOHyper(learning_rate=3e-3))[
                0
            ], reward.mean()

        return jax.lax.scan(one, state, jax.random.split(key, 120))

    state, rewards = learn(jax.random.key(1), ppo.init(jax.random.key(0)))
    best = ppo.deployed(ppo.actor(state), obs, told)
    assert rewards[0] < 0.5 and jnp.abs(best - told).max() < 0.1


def test_what_is_told_changes_nothing_until_it_was_learned_from():
    ppo = make_ppo(PPOConfig(3, 1, 2, (8,), epochs=1, minibatches=2))
    state = ppo.init(jax.random.key(0))
    obs, some, other = jnp.ones((4, 3)), jnp.ones((4, 2)), -jnp.ones((4, 2))
    batch = batch_of(np.random.default_rng(0))
    untold = ppo.update(
        jax.random.key(1), state, batch._replace(extra=0.0 * batch.extra), PPOHyper()
    )[0]
    told = ppo.update(jax.random.key(1), state, batch, PPOHyper())[0]
    for ask in (ppo.deployed, ppo.value):
        for after in (state, untold):
            np.testing.assert_array_equal(
                ask(ppo.actor(after), obs, some), ask(ppo.actor(after), obs, other)
            )
        assert (
            jnp.abs(ask(ppo.actor(told), obs, some) - ask(ppo.actor(told), obs, other)).max() > 0.0
        )


def test_it_maps_over_seeds_and_sizes_are_checked():
    ppo = make_ppo(PPOConfig(3, 1, 2, (8,), epochs=1, minibatches=2))
    states = jax.vmap(ppo.init)(jax.random.split(jax.random.key(0), 2))
    batch = batch_of(np.random.default_rng(0))
    both = jax.tree.map(lambda x: jnp.stack([x, x]), batch)
    after, info = jax.eval_shape(
        jax.vmap(ppo.update, (0, 0, 0, None)),
        jax.random.split(jax.random.key(1), 2),
        states,
        both,
        PPOHyper(),
    )
    assert jax.tree.map(lambda x: x.shape, after) == jax.tree.map(
        lambda x: x.shape, states
    ) and info.kl.shape == (2,)
    with pytest.raises(BadInput, match="each must be positive"):
        make_ppo(PPOConfig(3, 0))
    with pytest.raises(BadInput, match="is none of"):
        make_ppo(PPOConfig(3, 1, activation="tahn"))
