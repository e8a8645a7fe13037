"""Phase 1 of the push with the MuJoCo scene in MJX as its simulator."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.adaptation.training import preset
from adaptsim_jax.space import gaussian
from adaptsim_jax.tasks.pushing import model
from adaptsim_jax.tasks.pushing.engines import make_backend
from adaptsim_jax.tasks.pushing.task import PushingConfig
from adaptsim_jax.tasks.pushing.trial import make_guide, make_simulator
from adaptsim_jax.tasks.registry import make_task


@pytest.mark.slow
def test_the_simulator_is_the_backend_of_that_name():
    config = PushingConfig(simulator="mjx")
    params, actions, starts = model.draw(3, 4)
    found = jax.jit(jax.vmap(make_simulator(config)))(
        jnp.asarray(params, jnp.float32), jnp.asarray(actions, jnp.float32)
    )
    expected = make_backend("native").simulate(params, actions, starts).state[..., :2]
    assert found.shape == (4, 130, 2) and make_guide(config) is not None
    assert (
        np.abs(np.asarray(found) - expected).max() < 0.002
    )  # m; MJX in float32, docs/results/pushing.md


@pytest.mark.slow
def test_policies_are_trained_refined_and_visits_made_in_it():
    """What Phase 1 takes of the task: `train_many` from the untrained, and `rehearse`; how good
    they are is not looked at.
    """
    options = {"duration": 0.65, "trials": 20, "rehearsal": [2, 1]}
    task = make_task("pushing", preset("mjx-pushing").task | options)
    mean = jnp.full(4, 0.5)

    def visit(key):
        policy = task.init_policy(key)

        def one(x):
            return jax.tree.map(lambda y: y[None], x)

        trained = task.train_many(
            key[None], one(gaussian(task.space, mean)), one(policy), jnp.full(1, 20)
        )
        policy = jax.tree.map(lambda x: x[0], trained)
        return policy, task.rehearse(key, policy, task.space.physical(mean))

    policy, seen = jax.jit(visit)(jax.random.key(0))
    assert np.isfinite(policy.weights).all() and 0 <= float(seen.tested) <= 1
    moved = np.linalg.norm(np.asarray(seen.points[:, -1]) - np.array(model.START), axis=-1)  # m
    assert np.all((moved > 0.01) & (moved < 2.0))
