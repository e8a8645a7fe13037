"""Actions corrected by what the target's own pushes showed."""

import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.adaptation.episode import AdaptationEpisode
from adaptsim_jax.baselines.arena import Arena, Memory, TrialBatch, lanes
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.files import without_nan
from adaptsim_jax.tasks.one_shot import leaves_by_name
from adaptsim_jax.tasks.pushing import one_shot as pushing_deployed
from adaptsim_jax.tasks.pushing import planar
from adaptsim_jax.tasks.pushing import task as pushing
from adaptsim_jax.tasks.pushing.corrections import PushRecord, nearer, refine, search, with_gaps
from adaptsim_jax.tasks.pushing.one_shot import make_pushing_one_shot
from adaptsim_jax.tasks.pushing.task import PushingConfig
from adaptsim_jax.tasks.pushing.trial import GOAL_CENTRE, sector_goals, unseen


def simulated(a):
    return jnp.stack([0.8 + 0.2 * a[0], 0.1 * a[1]])


ACTIONS = jnp.array([[-0.5, 0.0], [0.0, 0.4], [0.6, -0.3], [0.9, 0.9]])


def told(places, used=(True, True, True, False)):
    return PushRecord(ACTIONS, places, jnp.array(used))


def test_an_observed_push_is_expected_where_it_ended_and_far_ones_where_simulated():
    off = jnp.array([0.03, -0.02])
    mended = with_gaps(simulated, told(jax.vmap(simulated)(ACTIONS) + off[None]))
    for action in ACTIONS[:3]:
        np.testing.assert_allclose(mended(action) - simulated(action), off, atol=2e-3)
    far = jnp.array([-1.0, -3.0])
    np.testing.assert_allclose(mended(far), simulated(far), atol=1e-4)


def test_rows_that_do_not_count_or_failed_change_nothing():
    places = jax.vmap(simulated)(ACTIONS) + 0.05
    none = with_gaps(simulated, told(places, (False,) * 4))
    np.testing.assert_array_equal(none(ACTIONS[0]), simulated(ACTIONS[0]))
    failed = with_gaps(simulated, told(places.at[1].set(jnp.nan)))
    np.testing.assert_allclose(failed(ACTIONS[0]), places[0], atol=2e-3)
    without = with_gaps(simulated, told(places, (True, False, True, False)))
    np.testing.assert_array_equal(failed(ACTIONS[1]), without(ACTIONS[1]))


@pytest.mark.slow
def test_the_mean_moves_to_parameters_that_explain_the_pushes_and_stays_within_omega():
    space = pushing.pushing_space()

    def end(u, a):
        return planar.rollout(space.physical(u), pushing.physical_action(a))[-1]

    actions = jnp.asarray(np.random.default_rng(0).uniform(-1, 1, (12, 2)), jnp.float32)
    truth, mean = jnp.array([0.4, 0.6, 0.7, 0.5]), jnp.array([0.5, 0.45, 0.6, 0.6])

    def there(u):
        return jax.vmap(lambda a: end(u, a))(actions)

    move = jax.jit(lambda places, used: nearer(end, mean, PushRecord(actions, places, used)))
    every = jnp.ones(12, bool)

    def off(u):
        return np.linalg.norm(there(u) - there(truth), axis=1).mean()

    found = move(there(truth), every)
    assert off(found) < 0.1 * off(mean) and np.abs(found - truth)[0] < 0.3 * np.abs(mean - truth)[0]
    np.testing.assert_array_equal(move(there(truth), ~every), mean)
    # two that failed tell nothing
    some = every.at[:2].set(False)
    np.testing.assert_array_equal(
        move(there(truth).at[:2].set(jnp.nan), every), move(there(truth), some)
    )
    # a target more slippery than any of Omega
    beyond = move(
        jax.vmap(
            lambda a: planar.rollout(jnp.array([0.03, 1e5, 0.5, 0.0]), pushing.physical_action(a))[
                -1
            ]
        )(actions),
        every,
    )
    assert beyond[0] < mean[0] - 0.1 and np.all(beyond >= 0.0) and np.all(beyond <= 1.0)


@pytest.mark.slow
def test_a_goal_that_no_step_leads_to_is_found_by_searching():
    """Faster pushes go less far at first (a bottle that is caught), and the farthest only
    beyond.
    """

    def far(x):
        return jnp.where(x > 0.5, 0.9 + 0.1 * x, 0.8 - 0.15 * (x + 0.5))

    def push(a):
        return jnp.stack([far(a[0]), 0.1 * a[1]])

    goals, first = jnp.array([[0.97, 0.05], [0.7, -0.05]]), jnp.array([[-0.5, 0.0], [0.0, 0.0]])

    def apart(found):
        return np.linalg.norm(jax.vmap(push)(found) - goals, axis=1)

    stuck = jax.vmap(lambda g, a: refine(push, g, a, 8))(goals, first)
    assert apart(stuck)[0] > 0.05
    assert np.all(apart(search(push, goals, first, 8)) < 0.005)
    np.testing.assert_array_equal(search(push, goals, first, 8, False), stuck)


def test_memory_shares_between_the_starts_of_a_seed_and_with_no_one_else():
    config = PushingConfig(pretrain=True, refine=2, correct=True, tests=2)
    one = make_pushing_one_shot(config)
    batch = lanes(2, np.array([0, 1]), 2, label=1)
    arena = Arena(
        one, one.world("planar"), np.array([[0.1, 1e5, 0.6, 0.05], [0.25, 5e4, 0.1, -0.1]])
    )
    memory = Memory(arena, batch, 3)
    policies = arena.untrained(batch.keys)
    assert memory.deployed(policies) is policies
    lane = np.arange(8, dtype=np.float32)
    actions = np.broadcast_to(lane[:, None, None], (8, 2, 2))
    memory.add(
        TrialBatch(np.zeros((8, 2, 2), np.float32), actions, np.zeros((8, 2, 6, 2), np.float32))
    )
    there = memory.deployed(policies).told
    assert there.actions.shape == (8, 12, 2)
    np.testing.assert_array_equal(there.used, np.arange(12)[None].repeat(8, 0) < 4)
    np.testing.assert_array_equal(there.actions[5, :4, 0], [4, 4, 5, 5])
    np.testing.assert_array_equal(there.actions[4], there.actions[5])


@pytest.mark.slow
def test_a_corrected_policy_earns_more_in_a_target_that_its_mean_of_e_does_not_explain():
    config = PushingConfig(pretrain=True, refine=6, correct=True, tests=8, goals="drawn")
    one, space = make_pushing_one_shot(config), pushing.pushing_space(config)
    target = np.array([[0.12, 3e5, 0.3, 0.0]])
    arena = Arena(one, one.world("planar"), target)
    batch = lanes(1, np.array([0]), 1, label=1)
    blank = arena.untrained(batch.keys)
    wrong = jnp.asarray(space.unit(jnp.asarray(target, jnp.float32))) + jnp.array(
        [[0.2, -0.2, 0.0, 0.0]]
    )
    policies, memory = blank._replace(at=wrong), Memory(arena, batch, 8)
    plain = arena.score(batch.where, memory.deployed(policies))
    for i in range(8):
        memory.add(arena.visit(batch.at(i), batch.where, policies).trials)
    mended = arena.score(batch.where, memory.deployed(policies))
    assert (1.0 - mended) < 0.4 * (1.0 - plain)  # by gaps over the actions alone: 0.885 and 0.974


@pytest.mark.slow
def test_pushes_that_fail_in_the_target_do_not_count_and_are_null_in_a_file(monkeypatch):
    config = PushingConfig(
        pretrain=True, refine=1, correct=True, tests=2, hidden=(8,), trajectories=4
    )

    def fails(params, action):
        return jnp.where(action[1] > 0, jnp.nan, jnp.full((1, 2), 0.8))

    monkeypatch.setattr(pushing_deployed, "make_simulator", lambda config: fails)
    blank = pushing.make_pushing(config).init_policy(jax.random.key(0))
    policies = jax.tree.map(lambda x: jnp.broadcast_to(x, (1, 2, *x.shape)), blank)
    goals = jnp.array(
        [[0.0, 0.9], [0.0, -0.9], [0.5, 0.9], [0.5, -0.9]]
    )  # to the left and to the right
    seen = jnp.concatenate([jnp.zeros((4, 6, 2)), goals[:, None]], 1).reshape(-1)
    obs = jnp.broadcast_to(jnp.concatenate([jnp.zeros(4), seen]), (1, 2, 4 + seen.size))
    history = AdaptationEpisode(
        jnp.full((1, 2, 4), 0.5),
        policies,
        obs,
        jnp.zeros((1, 2)),
        jnp.zeros((1, 2)),
        jnp.zeros((1, 1, 4)),
    )
    target = jnp.array([0.12, 3e5, 0.3, 0.0])
    made, every = pushing_deployed.deployed(history, target, config)
    failed = np.asarray(every.actions[:, 1] > 0)
    assert 0 < failed.sum() < 8
    np.testing.assert_array_equal(every.used, ~failed)
    np.testing.assert_array_equal(made.told.used[0, 1], ~failed & (np.arange(8) < 4))
    text = json.dumps(without_nan(leaves_by_name(blank._replace(told=every))), allow_nan=False)
    assert text.count("null") == 2 * failed.sum()


def test_correction_without_refining_is_refused():
    with pytest.raises(BadInput, match="give refine"):
        pushing.make_pushing(replace(PushingConfig(pretrain=True), correct=True))


@pytest.mark.slow
def test_deployed_pushes_are_visited_and_shown_for_the_goals_that_e_expects_of_them():
    options = {
        "pretrain": True,
        "refine": 2,
        "correct": True,
        "tests": 2,
        "show_gap": True,
        "hidden": (8,),
    }
    config = PushingConfig(visits="deployed", **options)
    goals = np.asarray(
        jax.vmap(lambda k: sector_goals(k, 2, 4))(jax.random.split(jax.random.key(0), 100))
    )
    centre = np.array(GOAL_CENTRE)
    angle, radius = (
        goals[..., 1] / (goals[..., 0] - centre[0]),
        np.linalg.norm(goals - centre, axis=-1),
    )
    assert (
        np.all(angle[:, 0] < 0)
        and np.all(angle[:, 1] > 0)
        and radius.min() < 0.28
        and radius.max() > 0.52
    )
    one, target = make_pushing_one_shot(config), np.array([[0.12, 3e5, 0.3, 0.0]])
    arena, batch = Arena(one, one.world("planar"), target), lanes(1, np.array([0]), 1, label=1)
    policies, memory = arena.untrained(batch.keys), Memory(arena, batch, 2)
    first = arena.visit(batch.at(0), batch.where, memory.visiting(policies))
    memory.add(first.trials)
    mended = memory.visiting(policies)
    second = arena.visit(batch.at(1), batch.where, mended)
    made, now = first.trials.actions[0], second.trials.actions[0]
    assert np.linalg.norm(now[:, None] - made[None], axis=-1).min() > 0.2

    def act(p):
        return np.asarray(arena._act(p, jnp.asarray(second.trials.contexts)))

    np.testing.assert_allclose(second.trials.actions, act(mended), atol=1e-5)
    seen = second.obs[0].reshape(2, 13, 2)  # six points, the goal, six gaps
    assert np.abs(second.trials.actions - act(policies)).max() > 0.01  # and not E's own
    shown = np.asarray(unseen(jnp.asarray(seen[:, 6])))
    params = pushing.pushing_space().physical(policies.at[0])
    ends = jax.vmap(lambda a: planar.rollout(params, pushing.physical_action(a))[-1])(
        jnp.asarray(second.trials.actions[0])
    )
    np.testing.assert_allclose(shown, ends, atol=1e-4)
    with pytest.raises(BadInput, match="set correct"):
        pushing.make_pushing(replace(config, show_gap=False))
