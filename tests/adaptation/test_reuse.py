"""The rules of reuse one by one, on a pool small enough to follow by hand. A policy is a pair of
numbers.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.adaptation.reuse import (
    Loan,
    Pool,
    ReuseConfig,
    check,
    empty_pool,
    lend,
    settle,
    train_loans,
)
from adaptsim_jax.core.errors import BadInput

RULES = ReuseConfig(
    threshold=0.16, first=1000, most=2500, least=850, decay=0.9, capacity=4, together=1
)
OWN = -1.0


def _visit(
    pool: Pool, *places: tuple[float, float], rules: ReuseConfig = RULES
) -> tuple[Pool, Loan]:
    """Visit `places` at once; training adds the trials to the first number and leaves the visit's
    place in the second.
    """
    means = jnp.array(places)
    loan = jax.jit(lend, static_argnums=1)(pool, rules, means, jnp.full((len(places), 2), OWN))
    policies = jnp.stack([loan.policy[:, 0] + loan.budget, means[:, 0]], -1)
    return jax.jit(settle, static_argnums=1)(pool, rules, means, policies, loan), loan


@pytest.fixture
def pool():
    return empty_pool(RULES, 2, jax.ShapeDtypeStruct((2,), jnp.float32))


def test_the_first_distribution_trains_its_own_policy_with_m(pool):
    pool, loan = _visit(
        pool, (0.0, 0.0)
    )  # the empty pool's zeros lie here, and must not be taken for an anchor
    assert loan.place.tolist() == [-1] and loan.budget.tolist() == [1000]
    assert loan.policy[0, 0] == OWN
    assert pool.count == 1 and pool.taught[0] == 1 and pool.spent[0] == 1000


def test_within_the_threshold_the_policy_is_reused_and_beyond_it_is_not(pool):
    pool, _ = _visit(pool, (0.5, 0.5))
    _, loan = _visit(pool, (0.5 + 0.15, 0.5), (0.5 + 0.12, 0.5 + 0.12), (0.5 + 0.161, 0.5))
    assert loan.place.tolist() == [0, -1, -1]  # 0.15 is near; 0.17 and 0.161 are not
    assert loan.policy[0, 0] == OWN + 1000 and loan.policy[1, 0] == OWN


def test_the_nearest_of_several_is_reused(pool):
    pool, _ = _visit(pool, (0.1, 0.5), (0.35, 0.5))
    _, loan = _visit(pool, (0.24, 0.5), (0.21, 0.5))
    assert loan.place.tolist() == [1, 0]


def test_budget_decays_with_each_distribution_down_to_the_least_and_ends_at_the_most(pool):
    """M = 1000, alpha = 0.9, M_min = 850, M_max = 2500: 1000, 900, then max(850, 810); the fourth
    finds 2750 spent.
    """
    budgets, pool = [], _visit(pool, (0.5, 0.5))[0]
    for x in (0.55, 0.45, 0.5, 0.6):
        pool, loan = _visit(pool, (x, 0.5))
        budgets.append(int(loan.budget[0]))
    assert budgets == [900, 850, 0, 0]
    assert pool.spent[0] == 2750 and pool.taught[0] == 3
    assert loan.policy[0, 0] == OWN + 2750  # not trained again, yet reused, as trained last
    assert pool.policy[0, 1] == np.float32(0.45)  # by the last one that trained it


def test_a_borrower_does_not_lend(pool):
    """0.5 lends to 0.62. 0.74 is within reach of 0.62 but not of 0.5: it must train a policy of its
    own.
    """
    pool, _ = _visit(pool, (0.5, 0.5))
    pool, loan = _visit(pool, (0.62, 0.5))
    assert loan.place.tolist() == [0] and pool.count == 1
    pool, loan = _visit(pool, (0.74, 0.5))
    assert loan.place.tolist() == [-1] and loan.budget.tolist() == [1000] and pool.count == 2
    # and 0.62, back again, is now as near to the new anchor as to its lender
    _, loan = _visit(pool, (0.63, 0.5))
    assert loan.place.tolist() == [1]


def test_loans_at_the_same_time_all_count_and_the_first_policy_is_kept(pool):
    pool, _ = _visit(pool, (0.5, 0.5))
    pool, loan = _visit(pool, (0.9, 0.9), (0.55, 0.5), (0.45, 0.5))
    assert loan.place.tolist() == [-1, 0, 0] and loan.budget.tolist() == [1000, 900, 900]
    assert pool.taught.tolist()[:2] == [3, 1] and pool.spent.tolist()[:2] == [2800, 1000]
    assert pool.policy[0].tolist() == pytest.approx([OWN + 1900, 0.55]) and pool.count == 2


def test_at_the_same_time_nobody_sees_the_others_yet(pool):
    pool, loan = _visit(pool, (0.5, 0.5), (0.51, 0.5))
    assert loan.place.tolist() == [-1, -1] and pool.count == 2


def test_a_full_pool_forgets_its_oldest_anchors(pool):
    corners = ((0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0))
    for place in (*corners, (0.5, 0.5)):
        pool, _ = _visit(pool, place)
    assert pool.count == 5 and pool.mean[0].tolist() == [0.5, 0.5]
    _, loan = _visit(pool, (0.0, 0.0), (0.0, 1.0))
    assert loan.place.tolist() == [-1, 1]


def test_training_in_groups_gives_each_its_own_budget_and_place():
    """Sorted by budget inside, in the order of the visits outside; a group takes as long as its
    largest budget.
    """
    longest = []

    def train_many(keys, dists, policies, budgets):
        jax.debug.callback(lambda b: longest.append(int(b)), budgets.max())
        return policies + budgets.astype(jnp.float32) + dists

    budget = jnp.array([0, 900, 0, 1000, 0, 10], jnp.int32)
    loan = Loan(jnp.arange(6.0), -jnp.ones(6, jnp.int32), budget)
    keys = jax.random.split(jax.random.key(0), 6)
    out = jax.jit(train_loans, static_argnums=(1, 4))(keys, train_many, 0.5 * jnp.ones(6), loan, 2)
    jax.effects_barrier()
    np.testing.assert_array_equal(out, np.arange(6) + np.asarray(budget) + 0.5)
    assert sorted(longest) == [0, 10, 1000]


@pytest.mark.parametrize(
    "bad",
    [
        {"threshold": -0.1},
        {"decay": 0.0},
        {"least": 2000},
        {"most": 10},
        {"capacity": 3},
        {"together": 3},
    ],
)
def test_bad_rules_are_refused(bad):
    check(RULES, 4)
    with pytest.raises(BadInput):
        check(replace(RULES, **bad), 4)
