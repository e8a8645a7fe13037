"""Deployed scoops corrected by what the target's own scoops came to."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.scooping import task as scooping
from adaptsim_jax.tasks.scooping.bank import load_bank
from adaptsim_jax.tasks.scooping.corrections import Doubt, Odds, ScoopRecord, chances
from adaptsim_jax.tasks.scooping.deployed import expected_odds, make_choice, make_probe
from adaptsim_jax.tasks.scooping.model import Numerics, ScoopOptions
from adaptsim_jax.tasks.scooping.one_shot import make_scooping_one_shot
from adaptsim_jax.tasks.scooping.task import ScoopingConfig

DOUBT = Doubt(others=1.0, reach=0.5, spread=1.5, most=3.0)
ALONE = DOUBT._replace(others=0.0)
ACTIONS = jnp.array([[-0.5, 0.0, 0.2], [-0.4, 0.1, 0.2], [0.6, -0.3, -0.8], [0.9, 0.9, 0.9]])
WON = jnp.array([1.0, 0.0, 1.0, 1.0])
TRIED = jnp.array([[-0.3, 0.2, 0.1], [0.5, -0.2, -0.5]])
KNOWN = jnp.arange(4) < 3


PIECES = np.array([[1.0, 0.5, 0.0], [-2.0, 0.0, 1.0]])


def odds(actions):
    """Of a piece whose odds fall with pitch, and of two others."""
    return Odds(
        0.5 - 2.0 * actions[:, 0] + actions[:, 2], actions @ jnp.asarray(PIECES.T, actions.dtype)
    )


chance = jax.jit(
    lambda told, tried, doubt: chances(told, odds(told.actions), tried, odds(tried), doubt)
)


def test_chances_are_those_of_laplaces_approximation_found_by_another_optimiser():
    actions, asked, won = (np.asarray(x, float) for x in (ACTIONS[:3], TRIED, WON[:3]))

    def held(x):
        return 3.0 * np.tanh(np.asarray(x, float) / 3.0)

    def ways(a):
        return (
            held(odds(jnp.asarray(a)).others) - held(odds(jnp.asarray(a)).expected)[:, None]
        ) / np.sqrt(2)

    def near(a, b):
        return 1.5**2 * np.exp(-0.5 * (((a[:, None] - b[None]) / 0.5) ** 2).sum(-1))

    def kernel(a, b):
        return ways(a) @ ways(b).T + near(a, b)

    K, m = kernel(actions, actions), held(odds(jnp.asarray(actions)).expected)

    def cost(g):
        return 0.5 * g @ np.linalg.solve(K, g) + np.logaddexp(0, m + g).sum() - won @ (m + g)

    g = optimize.minimize(cost, np.zeros(3), tol=1e-12).x
    p = 1 / (1 + np.exp(-m - g))
    across, own = kernel(asked, actions), np.diag(kernel(asked, asked))
    variance = own - np.einsum(
        "ai,ij,aj->a", across, np.linalg.inv(K + np.diag(1 / (p * (1 - p)))), across
    )
    mean = held(odds(jnp.asarray(asked)).expected) + across @ np.linalg.solve(K, g)
    want = 1 / (1 + np.exp(-mean / np.sqrt(1 + np.pi / 8 * variance)))
    np.testing.assert_allclose(
        chance(ScoopRecord(ACTIONS, WON, KNOWN), TRIED, DOUBT), want, rtol=2e-3
    )


def test_rows_that_do_not_count_change_nothing():
    one = chance(ScoopRecord(ACTIONS, WON, KNOWN), TRIED, DOUBT)
    other = ScoopRecord(ACTIONS.at[3].set(-0.3), WON.at[3].set(0.0), KNOWN)
    np.testing.assert_allclose(chance(other, TRIED, DOUBT), one, rtol=1e-5)
    assert np.abs(chance(ScoopRecord(ACTIONS, WON, KNOWN & False), TRIED, DOUBT) - one).max() > 0.05


@pytest.mark.slow
@pytest.mark.parametrize("won", [0.0, 1.0])
def test_what_was_seen_outweighs_the_bank_where_it_was_seen_and_not_far_from_it(won):
    """32 scoops at one action, all lost or all won, where the bank is sure of the contrary."""
    tried = jnp.array([[0.0, 0.0, 0.0], [1.0, 1.0, -1.0]])

    def sure(n):
        return Odds(jnp.full(n, 8.0 - 16.0 * won), jnp.zeros((n, 1)))

    told = ScoopRecord(jnp.zeros((32, 3)), jnp.full(32, won), jnp.ones(32, bool))
    there, far = chances(told, sure(32), tried, sure(2), ALONE)
    assert abs(there - won) < 0.25 and abs(far - won) > 0.75


def test_one_scoop_tells_of_far_actions_what_pieces_have_in_common():
    """The bank has a piece that wins where this one is expected to lose; a scoop that says so
    speaks for all of its actions.
    """
    told, tried = (
        ScoopRecord(jnp.zeros((1, 3)), jnp.ones(1), jnp.ones(1, bool)),
        jnp.array([[1.0, -1.0, 1.0]]),
    )
    lost = Odds(jnp.full(1, -2.0), jnp.full((1, 2), 3.0))
    assert (
        chances(told, lost, tried, lost, DOUBT)[0]
        > chances(told, lost, tried, lost, ALONE)[0] + 0.2
    )


def test_expected_odds_are_of_the_mean_chance_over_errors():
    bank, params, options = (
        load_bank(ScoopOptions(), Numerics()),
        jnp.array([0.3, 2e5, 1.0, 0.02]),
        ScoopOptions(),
    )
    action, contexts = jnp.array([0.2, -0.1, 0.3]), jnp.asarray(scooping.test_contexts(2000))
    each = jax.vmap(
        lambda c: scooping.bank_chance(bank, params, scooping.executed(action, c, options))
    )(contexts)
    got = expected_odds(bank, params, action, options)
    assert 0.02 < each.mean() < 0.98 and abs(jax.nn.sigmoid(got) - each.mean()) < 0.01


@pytest.mark.slow
def test_a_policy_is_corrected_only_once_it_was_told_of_the_target():
    config = ScoopingConfig(correct=True)
    act, naf = jax.jit(make_choice(config)), scooping.make_scooping_naf(config)
    policy = scooping.make_scooping(config).init_policy(jax.random.key(2))
    contexts = jnp.asarray(scooping.test_contexts(3))
    own = naf.greedy(policy.weights, scooping.place_input(contexts))
    np.testing.assert_array_equal(act(policy, contexts), own)
    good = jnp.array([[-0.8, -0.8, 0.8]])
    actions = jnp.concatenate(
        [jnp.tile(good, (16, 1)), jnp.asarray(2.0 * np.random.default_rng(0).random((48, 3)) - 1.0)]
    )
    won = (jnp.linalg.norm(actions - good, axis=-1) < 0.4).astype(jnp.float32)
    found = act(policy._replace(told=ScoopRecord(actions, won, jnp.ones(64, bool))), contexts)
    assert found.shape == (3, 3) and jnp.linalg.norm(found - good, axis=-1).max() < 0.5
    np.testing.assert_array_equal(found[0], found[2])
    without = scooping.make_scooping(replace(config, correct=False)).init_policy(jax.random.key(2))
    assert without.at is None and len(jax.tree.leaves(without)) == 1


@pytest.mark.slow
def test_the_last_scoop_of_a_visit_is_a_probe():
    config = ScoopingConfig(correct=True, hidden=(16,), tests=2)
    task, contexts = scooping.make_scooping(config), jnp.asarray(scooping.test_contexts(2))
    policy, tried = task.init_policy(jax.random.key(2)), jnp.array([0.5, -0.5, 0.25])
    probing = policy._replace(probe=tried)
    act = jax.jit(make_choice(config))
    own, made = act(policy, contexts), act(probing, contexts)
    np.testing.assert_array_equal(made[0], own[0])
    np.testing.assert_array_equal(made[1], tried)
    params = jnp.asarray(task.space.values(task.settings["wd"]), jnp.float32)
    rehearse = jax.jit(task.rehearse)
    with_probe, without = (rehearse(jax.random.key(1), p, params) for p in (probing, policy))
    np.testing.assert_array_equal(with_probe.points[0], without.points[0])
    assert np.abs(with_probe.points[1] - without.points[1]).max() > 1e-3
    assert with_probe.tested == without.tested


def test_probes_leave_what_was_lost():
    """Eight times a scoop is probed and lost. One loss may be luck, so that it may be tried again,
    but hardly more.
    """
    config = ScoopingConfig(correct=True)
    policy = scooping.make_scooping(config).init_policy(jax.random.key(2))
    probe, told = (
        jax.jit(make_probe(config)),
        ScoopRecord(jnp.zeros((8, 3)), jnp.zeros(8), jnp.zeros(8, bool)),
    )
    for i in range(8):
        tried = probe(policy._replace(told=told))
        assert tried.told is None
        told = told._replace(
            actions=told.actions.at[i].set(tried.probe), used=told.used.at[i].set(True)
        )
    apart = np.linalg.norm(told.actions[:, None] - told.actions[None], axis=-1)
    assert np.sum(apart < 0.1, 1).max() <= 2 and apart.max() > 1.0


def test_what_the_comparison_remembers_is_actions_and_whether_they_won():
    """A trial that failed counts as lost, as in the table."""
    one = make_scooping_one_shot(ScoopingConfig(correct=True))
    outcomes = jnp.zeros((3, 9, 2)).at[1, -1, 0].set(1.0).at[2].set(jnp.nan)
    policy = one.remember(
        one.task.init_policy(jax.random.key(0)),
        ACTIONS[:3],
        outcomes,
        jnp.array([True, True, False]),
    )
    assert policy.told.won.tolist() == [0.0, 1.0, 0.0] and policy.told.used.tolist() == [
        True,
        True,
        False,
    ]
    np.testing.assert_array_equal(policy.told.actions, ACTIONS[:3])
    assert make_scooping_one_shot(ScoopingConfig()).remember is None


def test_correcting_needs_pieces_that_the_bank_holds():
    with pytest.raises(BadInput, match="the bank holds pieces"):
        scooping.make_scooping(
            ScoopingConfig(source="simulator", rehearsal="simulator", correct=True, h=(0.01, 0.02))
        )
