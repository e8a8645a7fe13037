"""The push as a task: what it observes and rewards, that training reaches what the model allows,
and Phase 1 on it.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.adaptation.episode import StepPlan
from adaptsim_jax.adaptation.phase1 import Phase1Config, make_phase1
from adaptsim_jax.adaptation.phase2 import adapt, draw_starts
from adaptsim_jax.adaptation.reuse import ReuseConfig
from adaptsim_jax.adaptation.training import preset, traced
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.learners.naf_goals import GoalConfig
from adaptsim_jax.space import Gaussian, gaussian
from adaptsim_jax.tasks.pushing import model, planar
from adaptsim_jax.tasks.pushing import task as pushing
from adaptsim_jax.tasks.pushing.task import (
    PushingConfig,
    PushingTrajectory,
    make_policy,
    make_pushing,
)
from adaptsim_jax.tasks.registry import make_task

SHORT = PushingConfig(
    trials=60,
    tests=6,
    hidden=(16,),
    training=GoalConfig(block=20, updates=5, batch=16, capacity=60),
)
GOALS = jnp.array([[0.75, 0.0], [0.9, -0.08]])


def test_goals_lie_in_the_papers_region():
    goals = np.asarray(jax.vmap(pushing.draw_goal)(jax.random.split(jax.random.key(0), 2000)))
    assert goals[:, 0].min() > 0.69 and goals[:, 0].max() <= 1.0 and np.ptp(goals[:, 0]) > 0.29
    assert np.abs(np.arctan2(goals[:, 1], goals[:, 0] - 0.45)).max() <= 0.175 + 1e-6
    grid = np.asarray(pushing.goal_lattice(24))
    assert abs(grid.mean(0)[0] - goals.mean(0)[0]) < 0.01 and abs(grid.mean(0)[1]) < 0.01


def test_reward_by_hand():
    final = jnp.array([[0.75, 0.0], [0.75, 0.05], [0.95, 0.0], [jnp.nan, 0.0]])
    np.testing.assert_allclose(
        pushing.push_reward(final, GOALS[:1].repeat(4, 0)), [1.0, 0.75, 0.0, 0.0], atol=1e-6
    )


def test_actions_span_the_papers_speeds_and_angles():
    corners = pushing.physical_action(jnp.array([[-1.0, -1.0], [1.0, 1.0], [0.0, 0.0]]))
    np.testing.assert_allclose(corners, [[0.4, -0.3], [0.8, 0.3], [0.6, 0.0]], atol=1e-6)


@pytest.mark.parametrize(
    "observation, shown, size", [("points", True, 28), ("points", False, 24), ("final", False, 4)]
)
def test_observations(observation, shown, size):
    """Six points of two pushes: rows 22, 43, 65, 87, 108, 130 of 130; goals after them where
    shown.
    """
    config = replace(SHORT, observation=observation, show_goal=shown)
    task = make_pushing(config)
    times = jnp.arange(1, 131) / 130
    places = jnp.stack(
        [
            jnp.stack([0.7 + 0.3 * times, 0.1 * times], -1),
            jnp.stack([0.85 + 0 * times, -0.1 * times], -1),
        ]
    )
    trajectory = pushing.measured(GOALS, places)
    seen = np.asarray(task.observe(trajectory)).reshape(2, -1, 2)
    assert task.obs_dim == size == seen.size
    ends = seen[:, 5 if observation == "points" else 0]
    np.testing.assert_allclose(ends, [[1.0, 1.0], [0.0, -1.0]], atol=1e-5)
    if observation == "points":
        rows = np.array([22, 43, 65, 87, 108, 130]) / 130
        np.testing.assert_allclose(seen[0, :6, 0], 2 * rows - 1, atol=1e-5)
    if shown:
        np.testing.assert_allclose(
            seen[:, -1], (np.asarray(GOALS) - [0.85, 0.0]) / [0.15, 0.1], atol=1e-5
        )
    np.testing.assert_allclose(task.score(trajectory), trajectory.rewards.mean())
    np.testing.assert_allclose(task.reward(trajectory, None), trajectory.rewards.mean())


def test_a_bottle_lost_from_sight_gives_reward_0_and_no_nan_to_a_network():
    places = jnp.full((2, 130, 2), jnp.nan).at[1].set(1e6)
    trajectory = pushing.measured(GOALS, places)
    assert (
        trajectory.rewards.tolist() == [0.0, 0.0]
        and np.isfinite(pushing.observed(trajectory, SHORT)).all()
    )


@pytest.mark.slow
def test_rollout_is_the_models_push_of_the_policys_action():
    task, act = make_pushing(SHORT), make_policy(SHORT)
    policy = jax.jit(task.init_policy)(jax.random.key(3))
    params = jnp.asarray(task.space.values(task.settings["ood-3"]), jnp.float32)
    got = jax.jit(task.rollout)(jax.random.key(1), policy, params)
    assert isinstance(got, PushingTrajectory) and got.points.shape == (2, 6, 2)
    final = jax.jit(jax.vmap(lambda g: planar.rollout(params, act(policy, g))[-1]))
    np.testing.assert_allclose(got.points[:, -1], final(got.goals), atol=1e-6)
    np.testing.assert_allclose(
        got.rewards, pushing.push_reward(final(got.goals), got.goals), atol=1e-5
    )
    np.testing.assert_allclose(
        got.tested,
        pushing.push_reward(final(pushing.goal_lattice(6)), pushing.goal_lattice(6)).mean(),
        atol=1e-5,
    )


def _oracle(params, goals):
    """Mean over goals of the best reward on a fine grid of actions, all of it with the model
    itself.
    """
    grid = jnp.stack(
        jnp.meshgrid(jnp.linspace(0.4, 0.8, 101), jnp.linspace(-0.3, 0.3, 25), indexing="ij"), -1
    )
    final = jax.jit(jax.vmap(lambda a: planar.rollout(params, a)[-1]))(grid.reshape(-1, 2))
    reward = jax.vmap(pushing.push_reward, (0, None))
    return np.asarray(jax.vmap(lambda g: reward(final, g).max())(goals)).mean()


@pytest.mark.slow
def test_training_reaches_most_of_what_the_model_allows():
    """3000 trials in WD: above 0.9 of the best action for each goal, far above an untrained
    policy.
    """
    config = PushingConfig(trials=3000)
    task = make_pushing(config)
    params = jnp.asarray(task.space.values(task.settings["wd"]), jnp.float32)
    policy = task.init_policy(jax.random.key(0))
    dist = gaussian(task.space, task.space.unit(params))
    trained = jax.jit(task.train)(jax.random.key(1), dist, policy)

    def reward(p):
        return float(jax.jit(task.rollout)(jax.random.key(2), p, params).tested)

    best = _oracle(params, pushing.goal_lattice(config.tests))
    assert reward(policy) < 0.7 * best
    assert reward(trained) > 0.9 * best


@pytest.mark.slow
def test_training_several_is_training_each_with_its_own_budget():
    task = make_pushing(SHORT)
    keys = jax.random.split(jax.random.key(0), 2)
    means = jnp.array([[0.2, 0.5, 0.5, 0.5], [0.9, 0.5, 0.1, 0.3]])
    dists = Gaussian(means, jnp.full_like(means, 1e-4))
    policies = jax.vmap(task.init_policy)(keys)
    together = jax.jit(task.train_many)(keys, dists, policies, jnp.array([60, 0]))
    alone = jax.jit(task.train)(
        keys[0], jax.tree.map(lambda x: x[0], dists), jax.tree.map(lambda x: x[0], policies)
    )
    np.testing.assert_allclose(together.weights[0], alone.weights, atol=1e-5)
    np.testing.assert_array_equal(together.weights[1], policies.weights[1])


@pytest.mark.slow
def test_phase_1_and_2_with_reused_policies():
    """Steps smaller than the threshold: visits after a start borrow, budgets shrink, and nothing is
    traced anew.
    """
    task = make_pushing(SHORT)
    sizes = Phase1Config(
        trajectories=8,
        parallel=4,
        horizon=3,
        updates=2,
        batch=8,
        capacity=24,
        archive=24,
        hidden=(16,),
        reuse=ReuseConfig(threshold=0.5, first=60, most=90, least=20, capacity=20, together=2),
    )
    phase1 = make_phase1(task, sizes)
    hyper = traced(preset("paper-pushing").hyper)
    state, info = jax.jit(phase1.run)(jax.jit(phase1.init)(jax.random.key(0)), hyper, jnp.arange(2))
    assert np.isfinite(info.reward).all() and np.all((info.reward >= 0) & (info.reward <= 1))
    assert info.reused[1] > info.reused[0] > 0.3 and info.trials[1] < info.trials[0] < 60
    # an anchor for each visit that borrowed nothing, and budgets spent only through the pool
    owned = round(float((1 - info.reused).sum()) * 4 * 4)
    assert int(state.pool.count) == owned and int(state.pool.spent.sum()) == round(
        float(info.trials.sum()) * 16
    )
    starts = draw_starts(jax.random.key(1), state.archive, 24, 2)
    target = jnp.asarray(task.space.values(task.settings["ood-1"]), jnp.float32)
    found = jax.jit(
        lambda k: adapt(k, task, phase1.bdq, state.learner.target, starts, target, StepPlan(2))
    )(jax.random.key(2))
    assert found.history.reward.shape == (2, 3) and 0 <= found.reward <= 1


def test_settings_are_physical_and_only_what_the_paper_bolds_is_outside():
    task = make_pushing(SHORT)
    outside = {
        name: {
            p
            for p, u in zip(
                task.space.names, np.asarray(task.space.unit(task.space.values(s))), strict=True
            )
            if not -1e-4 <= u <= 1 + 1e-4
        }
        for name, s in task.settings.items()
    }
    assert outside == {
        "wd": set(),
        "ood-1": {"mu", "mu_p"},
        "ood-2": {"mu_p"},
        "ood-3": {"e", "mu_p", "y_p"},
        "ood-4": {"mu", "mu_p"},
    }
    assert task.space.names == model.PARAMETERS


@pytest.mark.parametrize(
    "options, says",
    [
        ({"trails": 3}, "trials"),
        ({"trials": 0}, "trials = 0"),
        ({"friction": "x"}, "clean"),
        ({"model": {}}, "model"),
        ({"show_gap": True}, "show_gap: only a policy made with pretrain"),
    ],
)
def test_bad_options_are_refused(options, says):
    with pytest.raises(BadInput, match=says):
        make_task("pushing", options)
