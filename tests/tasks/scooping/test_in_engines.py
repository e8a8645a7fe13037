"""Scooping without the bank: in the hydroelastic engine, and in the MuJoCo scene in MJX."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.learners.naf_goals import GoalConfig
from adaptsim_jax.space import gaussian
from adaptsim_jax.tasks.scooping import model
from adaptsim_jax.tasks.scooping import task as scooping
from adaptsim_jax.tasks.scooping.one_shot import scooping_world
from adaptsim_jax.tasks.scooping.task import ScoopingConfig, make_scooping

SHORT = ScoopingConfig(
    trials=20,
    tests=2,
    hidden=(8,),
    training=GoalConfig(block=10, updates=2, batch=8, capacity=20, candidates=4),
)


def test_corrections_are_by_the_bank_and_refused_without():
    with pytest.raises(BadInput, match="simulator = 'mjx' does without; set correct = false"):
        make_scooping(replace(SHORT, simulator="mjx", correct=True))
    assert make_scooping(replace(SHORT, simulator="hydro")).rehearse is None
    assert make_scooping(SHORT).rehearse is not None


@pytest.mark.slow
def test_a_trial_in_mjx_is_that_of_the_world():
    """In double precision: in float32 contacts make tenths of a millimetre of the last digit, in
    one program as between two.
    """
    options = scooping.checked(SHORT)
    params, _ = model.draw(0, 6)
    params[5, 3] = 1.0  # m: no piece that the scene is made for
    contexts = scooping.test_contexts(6).astype(float)
    units = np.random.default_rng(1).uniform(-1, 1, (6, 3))
    with jax.enable_x64(True):
        trial = jax.jit(
            jax.vmap(scooping.make_mjx_trial.__wrapped__(options))
        )  # what is kept is for float32
        found = np.asarray(trial(params, units, contexts))
        expected, _ = scooping_world("mjx", options).run(params, contexts, units)
    assert np.isnan(found[5]).all() and np.isnan(expected[5]).all()
    np.testing.assert_allclose(
        found[:5], expected[:5], atol=1e-6
    )  # m; outcomes of a world are float32
    np.testing.assert_array_equal(scooping.success(found), scooping.success(expected))


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["hydro", "mjx"])
def test_policies_are_trained_and_visits_made_in_the_engine(engine):
    task = make_scooping(replace(SHORT, simulator=engine))
    mean = jnp.array([0.5, 0.5, 1.0, 0.5])
    policy = jax.jit(task.train)(
        jax.random.key(0), gaussian(task.space, mean), task.init_policy(jax.random.key(1))
    )
    seen = jax.jit(task.rollout)(jax.random.key(2), policy, task.space.physical(mean))
    assert np.isfinite(policy.weights).all() and 0 <= float(seen.tested) <= 1
    assert (
        np.isfinite(seen.points).all() and np.abs(seen.points).max() > 0.01
    )  # m: pieces were moved
