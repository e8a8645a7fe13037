"""Deployed scoops corrected by what the target's own scoops came to."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize

from adaptsim_jax.errors import BadInput
from adaptsim_jax.models.scooping import ScoopOptions
from adaptsim_jax.models.scooping_hydro import Numerics
from adaptsim_jax.tasks import scooping
from adaptsim_jax.tasks.scooping import ScoopingConfig
from adaptsim_jax.tasks.scooping_bank import load_bank
from adaptsim_jax.tasks.scooping_one_shot import make_choice
from adaptsim_jax.tasks.scooping_told import Doubt, Told, best_action, with_outcomes

DOUBT = Doubt(reach=0.5, spread=2.0, most=3.0)
ACTIONS = jnp.array([[-0.5, 0.0, 0.2], [-0.4, 0.1, 0.2], [0.6, -0.3, -0.8], [0.9, 0.9, 0.9]])
WON = jnp.array([1.0, 0.0, 1.0, 1.0])
odds = lambda a: 0.5 - 2.0 * a[0] + a[2]


def held(a):
    return DOUBT.most * np.tanh((0.5 - 2.0 * a[..., 0] + a[..., 2]) / DOUBT.most)


def test_chances_are_those_of_laplaces_approximation_found_by_another_optimiser():
    used, actions, won = 3, np.asarray(ACTIONS, float)[:3], np.asarray(WON, float)[:3]
    kernel = lambda a, b: 4.0 * np.exp(-0.5 * (((a[:, None] - b[None]) / 0.5) ** 2).sum(-1))
    K, m = kernel(actions, actions), held(actions)
    cost = lambda g: 0.5 * g @ np.linalg.solve(K, g) + np.logaddexp(0, m + g).sum() - won @ (m + g)
    g = optimize.minimize(cost, np.zeros(used), tol=1e-12).x
    p = 1 / (1 + np.exp(-m - g))
    asked = np.array([[-0.3, 0.2, 0.1], [0.5, -0.2, -0.5]])
    across = kernel(asked, actions)
    variance = 4.0 - np.einsum("ai,ij,aj->a", across, np.linalg.inv(K + np.diag(1 / (p * (1 - p)))), across)
    want = 1 / (1 + np.exp(-(held(asked) + across @ np.linalg.solve(K, g)) / np.sqrt(1 + np.pi / 8 * variance)))
    chance = with_outcomes(odds, Told(ACTIONS, WON, jnp.arange(4) < used), DOUBT)
    np.testing.assert_allclose(jax.vmap(chance)(jnp.asarray(asked, jnp.float32)), want, rtol=2e-3)


def test_rows_that_do_not_count_change_nothing():
    used = jnp.array([True, False, True, False])
    one = with_outcomes(odds, Told(ACTIONS, WON, used), DOUBT)
    two = with_outcomes(odds, Told(ACTIONS.at[1].set(0.3), 1.0 - WON + 2.0 * used * (WON - 0.5), used), DOUBT)
    asked = jnp.array([0.1, 0.1, -0.2])
    np.testing.assert_allclose(one(asked), two(asked), rtol=1e-5)
    assert abs(float(one(asked)) - float(with_outcomes(odds, Told(ACTIONS, WON, used & False), DOUBT)(asked))) > 0.01


@pytest.mark.parametrize("won", [0.0, 1.0])
def test_what_was_seen_outweighs_the_bank_where_it_was_seen_and_not_far_from_it(won):
    sure = lambda a: 8.0 * (1.0 - 2.0 * won) + 0.0 * a[0]
    none = Told(jnp.zeros((32, 3)), jnp.full(32, won), jnp.zeros(32, bool))
    chance = with_outcomes(sure, none._replace(used=jnp.ones(32, bool)), DOUBT)
    there, far = chance(jnp.zeros(3)), chance(jnp.array([1.0, 1.0, -1.0]))
    assert abs(there - won) < 0.2 and abs(far - won) > 0.7
    np.testing.assert_allclose(far, with_outcomes(sure, none, DOUBT)(jnp.ones(3)), atol=0.02)


def test_the_best_action_is_found_between_the_even_ones_and_among_the_known():
    at = jnp.array([0.62, -0.37, 0.11])
    near = lambda scale: lambda a: jnp.exp(-0.5 * jnp.sum(((a - at) / scale) ** 2))
    assert jnp.abs(best_action(near(0.5), jnp.zeros((1, 3))) - at).max() < 0.06
    narrow = best_action(near(0.02), jnp.stack([jnp.zeros(3), at + 0.03]))
    assert near(0.02)(narrow) >= near(0.02)(at + 0.03)
    edge = best_action(lambda a: a.sum(), jnp.zeros((1, 3)))
    assert jnp.abs(edge).max() <= 1.0 and edge.min() > 0.9


def test_expected_odds_are_of_the_mean_chance_over_errors():
    bank, params, options = load_bank(ScoopOptions(), Numerics()), jnp.array([0.3, 2e5, 1.0, 0.02]), ScoopOptions()
    action, contexts = jnp.array([0.2, -0.1, 0.3]), jnp.asarray(scooping.test_contexts(2000))
    each = jax.vmap(lambda c: scooping.bank_chance(bank, params, scooping.executed(action, c, options)))(contexts)
    got = scooping.expected_odds(bank, params, options)(action)
    assert 0.02 < each.mean() < 0.98 and abs(jax.nn.sigmoid(got) - each.mean()) < 0.01


def test_a_policy_is_corrected_only_once_it_was_told_of_the_target():
    config = ScoopingConfig(correct=True)
    act, naf = jax.jit(make_choice(config)), scooping.make_scooping_naf(config)
    policy = scooping.make_scooping(config).init_policy(jax.random.key(2))
    contexts = jnp.asarray(scooping.test_contexts(3))
    own = naf.greedy(policy.weights, scooping.seen_place(contexts))
    np.testing.assert_array_equal(act(policy, contexts), own)
    good = jnp.array([-0.8, -0.8, 0.8])
    actions = jnp.concatenate(
        [jnp.tile(good, (16, 1)), jnp.asarray(2.0 * np.random.default_rng(0).random((48, 3)) - 1.0)]
    )
    won = (jnp.linalg.norm(actions - good[None], axis=-1) < 0.4).astype(jnp.float32)
    found = act(policy._replace(told=Told(actions, won, jnp.ones(64, bool))), contexts)
    assert found.shape == (3, 3) and jnp.linalg.norm(found - good[None], axis=-1).max() < 0.5
    np.testing.assert_array_equal(found[0], found[2])
    without = scooping.make_scooping(replace(config, correct=False)).init_policy(jax.random.key(2))
    assert without.at is None and len(jax.tree.leaves(without)) == 1


def test_correcting_needs_pieces_that_the_bank_holds():
    with pytest.raises(BadInput, match="the bank holds pieces"):
        scooping.make_scooping(ScoopingConfig(source="simulator", rehearsal="simulator", correct=True, h=(0.01, 0.02)))
