"""Pushes corrected by trying them in the simulator at the mean of E."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.baselines.arena import Arena
from adaptsim_jax.core import config as configs
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.learners.naf_goals import GoalConfig
from adaptsim_jax.space import Gaussian
from adaptsim_jax.tasks.pushing import measured as pushing_measured
from adaptsim_jax.tasks.pushing import planar
from adaptsim_jax.tasks.pushing import task as pushing
from adaptsim_jax.tasks.pushing.corrections import refine
from adaptsim_jax.tasks.pushing.one_shot import make_pushing_one_shot
from adaptsim_jax.tasks.pushing.slide import Lacking
from adaptsim_jax.tasks.pushing.task import PushingConfig, PushingPolicy
from adaptsim_jax.tasks.pushing.trial import GOAL_ANGLE, GOAL_CENTRE

PLAIN = PushingConfig(
    tests=6, hidden=(16,), pretrain=True, goals="fixed", training=GoalConfig(block=20, capacity=60)
)
REFINED = replace(PLAIN, refine=6)


def blank(at=(0.5, 0.5, 0.5, 0.5)):
    """A policy that knows nothing, for the mean of E `at`."""
    weights = pushing.make_pushing_naf(PLAIN).init(jax.random.key(1)).online
    return PushingPolicy(weights, jnp.zeros((4, 16)), jnp.asarray(at))


def test_a_linear_push_is_solved_and_a_goal_out_of_reach_is_approached():
    slope, place = jnp.array([[0.25, 0.02], [-0.03, 0.1]]), jnp.array([0.85, 0.01])
    push, start = lambda a: place + slope @ a, jnp.array([0.1, -0.2])
    within = push(jnp.array([-0.6, 0.7]))
    np.testing.assert_allclose(refine(push, within, start, 12), [-0.6, 0.7], atol=0.02)
    beyond = push(jnp.array([1.6, 0.0]))
    found = refine(push, beyond, start, 12)
    assert np.abs(found).max() <= 1.0 and float(found[0]) > 0.95


def test_the_best_of_the_trials_is_given_and_one_trial_changes_nothing():
    def push(a):
        return jnp.array([0.85, 0.0]) + 0.3 * jnp.sin(20.0 * a)  # no slope is of use here

    goal, start = jnp.array([0.9, 0.05]), jnp.array([0.3, -0.4])
    missed = [
        float(jnp.linalg.norm(push(refine(push, goal, start, n)) - goal)) for n in range(1, 8)
    ]
    assert missed == sorted(missed, reverse=True)
    np.testing.assert_array_equal(refine(push, goal, start, 1), start)


@pytest.mark.slow
def test_refined_pushes_end_at_their_goals_in_the_simulator():
    params = pushing.pushing_space().physical(blank().at)
    goals = pushing.goal_lattice(12)
    place = jax.jit(jax.vmap(lambda a: planar.rollout(params, a)[-1]))

    def ends(config):
        return place(jax.jit(pushing.make_policy(config))(blank(), goals))

    rewards = [float(pushing.push_reward(ends(c), goals).mean()) for c in (PLAIN, REFINED)]
    assert rewards[0] < 0.75 and rewards[1] > 0.9


def test_a_policy_for_no_e_is_not_refined_and_refinement_without_a_mean_is_refused():
    policy, goals = PushingPolicy(blank().weights), pushing.goal_lattice(5)
    plain, refined = (pushing.make_policy(c)(policy, goals) for c in (PLAIN, REFINED))
    np.testing.assert_array_equal(plain, refined)
    with pytest.raises(BadInput, match="pretrain = true"):
        pushing.make_pushing(replace(REFINED, pretrain=False))
    with pytest.raises(BadInput, match="0 for none"):
        pushing.make_pushing(replace(PLAIN, rehearsal=(-1, 0)))


@pytest.mark.slow
def test_without_tuning_a_policy_is_only_moved_and_phase_1_has_tests_of_its_own():
    task = pushing.make_pushing(replace(REFINED, tune=False, rehearsal=(3, 2)))
    means = jnp.array([[0.2, 0.9, 0.4, 0.6]])
    policies = jax.tree.map(lambda x: x[None], blank())
    moved = jax.jit(task.train_many)(
        jax.random.split(jax.random.key(0), 1),
        Gaussian(means, 1e-4 + 0 * means),
        policies,
        jnp.array([40]),
    )
    np.testing.assert_array_equal(moved.at, means)
    np.testing.assert_array_equal(moved.weights, policies.weights)  # the tilt is 0 here
    assert task.rehearse is not None and pushing.make_pushing(REFINED).rehearse is None
    params = task.space.physical(jnp.array([0.4, 0.6, 0.5, 0.5]))
    whole, part = (
        jax.jit(run)(jax.random.key(0), blank(), params) for run in (task.rollout, task.rehearse)
    )
    np.testing.assert_array_equal(whole.goals, part.goals)
    assert float(whole.rewards.mean()) != float(part.rewards.mean()) and float(
        whole.tested
    ) != float(part.tested)


@pytest.mark.slow
def test_a_refined_policy_is_read_back_from_its_file(tmp_path):
    config, policy = (
        replace(REFINED, mu=(0.05, 0.3), friction="coupled"),
        blank((0.3, 0.6, 0.2, 0.7)),
    )
    path = tmp_path / "best.toml"
    configs.write(path, pushing_measured.policy_table(policy, config))
    goals = pushing.goal_lattice(4)
    expected = jax.jit(pushing.make_policy(config))(policy, goals)
    np.testing.assert_allclose(pushing_measured.read_policy(path)(goals), expected, atol=1e-5)
    assert np.abs(expected - pushing.make_policy(PLAIN)(policy, goals)).max() > 0.01
    table = configs.read(path)
    del table["policy"]["at"]
    configs.write(path, table)
    with pytest.raises(BadInput, match=r"policy\.at"):
        pushing_measured.read_policy(path)


@pytest.mark.slow
def test_a_policy_for_a_mended_push_is_refined_in_it_wherever_it_is_read(tmp_path):
    config, policy = replace(REFINED, mended=Lacking(tilt_y=0.05)), blank((0.3, 0.6, 0.2, 0.7))
    path, goals = tmp_path / "best.toml", pushing.goal_lattice(4)
    configs.write(path, pushing_measured.policy_table(policy, config))
    expected, level = (jax.jit(pushing.make_policy(c))(policy, goals) for c in (config, REFINED))
    assert np.abs(expected - level)[:, 1].max() > 0.01, "it aims uphill"
    np.testing.assert_allclose(pushing_measured.read_policy(path)(goals), expected, atol=1e-4)


@pytest.mark.slow
def test_the_gap_to_what_e_expects_is_observed_and_is_0_where_the_target_is_e():
    config = replace(REFINED, refine=2, show_gap=True)
    task = pushing.make_pushing(config)
    policy, shown = blank((0.3, 0.6, 0.2, 0.7)), 2 * 2 * 6
    run = jax.jit(lambda params: task.observe(task.rollout(jax.random.key(0), policy, params)))
    at_e, elsewhere = run(task.space.physical(policy.at)), run(task.space.physical(policy.at + 0.2))
    assert at_e.shape == (task.obs_dim,) and task.obs_dim == 2 * 2 * 13
    gaps = [np.asarray(o).reshape(2, 13, 2)[:, 7:].reshape(-1) for o in (at_e, elsewhere)]
    assert gaps[0].size == shown and np.abs(gaps[0]).max() < 1e-3 < 0.3 < np.abs(gaps[1]).max()
    one = make_pushing_one_shot(config)
    arena = Arena(one, one.world("planar"), np.asarray(task.space.physical(policy.at))[None])
    seen = arena.visit(
        jax.random.split(jax.random.key(1), 1),
        np.zeros(1, int),
        jax.tree.map(lambda x: x[None], policy),
    )
    np.testing.assert_allclose(seen.obs[0], at_e, atol=2e-3)


def test_goals_near_the_edges_are_the_same_for_every_key():
    config = replace(PLAIN, goals="edges")
    first, second = (np.asarray(pushing.visit_goals(jax.random.key(k), config)) for k in range(2))
    np.testing.assert_array_equal(first, second)
    angle = np.arctan2(first[:, 1], first[:, 0] - GOAL_CENTRE[0]) / GOAL_ANGLE
    np.testing.assert_allclose(angle, [-0.76, 0.76], atol=1e-3)
