"""The push with one policy for all of Omega: moved to a mean of E, lent to every visit of Phase 1,
and tuned in Phase 2.
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
from adaptsim_jax.adaptation.training import default_config, traced
from adaptsim_jax.baselines.adapting import first_policies
from adaptsim_jax.baselines.arena import Arena, MethodRun, lanes
from adaptsim_jax.learners.naf_goals import GoalConfig
from adaptsim_jax.learners.naf_shared import SharedConfig
from adaptsim_jax.space import Gaussian
from adaptsim_jax.tasks.pushing import task as pushing
from adaptsim_jax.tasks.pushing.one_shot import make_pushing_one_shot
from adaptsim_jax.tasks.pushing.task import PushingConfig, make_pushing

SIZES = GoalConfig(block=20, updates=5, batch=16, candidates=8, capacity=60)
SHORT = PushingConfig(
    trials=40,
    tests=6,
    hidden=(16,),
    pretrain=True,
    goals="fixed",
    training=SIZES,
    tuning=SIZES,
    shared=SharedConfig(contexts=20, trials=16, updates=20, batch=16, candidates=8),
)


@pytest.fixture(scope="module")
def made():
    task = make_pushing(SHORT)
    assert task.pretrain is not None
    return task, jax.jit(task.pretrain)(jax.random.key(0))


def test_training_without_trials_moves_a_policy_to_the_mean_and_back(made):
    task, shared = made
    means = jnp.array([[0.2, 0.9, 0.4, 0.6], [0.5, 0.5, 0.5, 0.5]])
    both = jax.tree.map(lambda x: jnp.stack([x, x]), shared)
    train = jax.jit(task.train_many)
    keys = jax.random.split(jax.random.key(1), 2)
    there = train(keys, Gaussian(means, jnp.full_like(means, 1e-4)), both, jnp.zeros(2, jnp.int32))
    np.testing.assert_array_equal(there.at, means)
    np.testing.assert_array_equal(there.weights[1], shared.weights)
    expected = shared.weights[:16] + 2.0 * (np.asarray(means[0]) - 0.5) @ np.asarray(shared.tilt)
    np.testing.assert_allclose(there.weights[0, :16], expected, atol=1e-5)
    np.testing.assert_array_equal(there.weights[0, 16:], shared.weights[16:])
    tuned = train(keys, Gaussian(means, jnp.full_like(means, 1e-4)), both, jnp.array([0, 40]))
    np.testing.assert_allclose(tuned.weights[0], there.weights[0], atol=1e-6)
    assert not np.allclose(tuned.weights[1], there.weights[1])


def test_fixed_goals_are_the_same_for_every_key_and_lie_in_the_sector():
    first, second = (np.asarray(pushing.visit_goals(jax.random.key(k), SHORT)) for k in range(2))
    np.testing.assert_array_equal(first, second)
    assert first[0, 1] < 0 < first[1, 1] and first[:, 0].min() > 0.69 and first[:, 0].max() < 1.0
    spread = [
        np.asarray(pushing.visit_goals(jax.random.key(k), replace(SHORT, goals="spread")))
        for k in range(20)
    ]
    assert all(g[0, 1] < 0 < g[1, 1] for g in spread) and np.ptp([g[0, 0] for g in spread]) > 0.02


@pytest.mark.slow
def test_phase_1_lends_the_one_policy_to_every_visit_and_phase_2_tunes_it(made):
    task, _ = made
    sizes = Phase1Config(
        trajectories=8,
        parallel=4,
        horizon=3,
        updates=2,
        batch=8,
        capacity=24,
        archive=24,
        hidden=(16,),
        reuse=ReuseConfig(threshold=9.0, first=20, most=30, least=10, capacity=4, together=4),
    )
    phase1 = make_phase1(task, sizes)
    hyper = traced(default_config("pushing").hyper)
    state, info = jax.jit(phase1.run)(jax.jit(phase1.init)(jax.random.key(0)), hyper, jnp.arange(2))
    assert (
        int(state.pool.count) == 1
        and info.trials.tolist() == [0.0, 0.0]
        and info.reused.tolist() == [1.0, 1.0]
    )
    np.testing.assert_array_equal(state.archive.policy.at, state.archive.mean)
    starts = draw_starts(jax.random.key(1), state.archive, 24, 2)
    target = jnp.asarray(task.space.values(task.settings["ood-1"]), jnp.float32)

    def run(k):
        return adapt(
            k,
            task,
            phase1.bdq,
            state.learner.target,
            starts,
            target,
            StepPlan(2, 0.2, 0.5),
        )

    found = jax.jit(run)(jax.random.key(2))
    moves = np.abs(np.diff(np.asarray(found.history.mean), axis=1))
    for i, size in enumerate((0.2, 0.1)):  # whole steps, or what is left up to the border of Omega
        assert moves[:, i].max() < size + 1e-5
    np.testing.assert_allclose(found.history.policy.at, found.history.mean, atol=1e-6)


def test_baselines_start_from_one_shared_policy_a_seed():
    one = make_pushing_one_shot(SHORT)
    targets = np.tile(one.task.space.values(one.task.settings["wd"]), (2, 1))
    bout = MethodRun(None, Arena(one, one.world("planar"), targets), np.array([3, 4]))
    batch = lanes(2, bout.seeds, 1, label=2)
    policies = first_policies(bout, batch, None)
    same_seed = batch.seed[:, None] == batch.seed[None]
    apart = np.abs(np.asarray(policies.weights)[:, None] - np.asarray(policies.weights)[None]).max(
        -1
    )
    assert np.all(apart[same_seed] == 0) and np.all(apart[~same_seed] > 0)
    seen = [
        bout.arena.visit(jax.random.split(jax.random.key(k), 4), batch.where, policies).obs
        for k in range(2)
    ]
    np.testing.assert_array_equal(*seen)
