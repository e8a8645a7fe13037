"""Omega moved by an offset is Omega with other ranges."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.adaptation.phase1 import Phase1Config
from adaptsim_jax.adaptation.training import TrainConfig
from adaptsim_jax.space import gaussian
from adaptsim_jax.tasks.pendulum.task import PendulumConfig, make_pendulum
from experiments.ranges import adaptsim_run, shiftable_pendulum

PLAIN = {"scaling": "paper", "reference": "optimum", "targets": "omega"}
OFFSET = np.array([0.0, 0.3, 0.0, 0.0], np.float32)


def test_offset_is_another_range():
    moved = shiftable_pendulum(PLAIN)(jnp.asarray(OFFSET))
    other = make_pendulum(PendulumConfig(**PLAIN, m2=(1.3, 2.3)))
    u, key, target = (
        jnp.array([0.2, 0.7, 0.1, 0.9]),
        jax.random.key(0),
        jnp.array([1.8, 0.3, 1.5, 1.5]),
    )
    for space, expected in ((moved.space, other.space), (moved.targets, other.targets)):
        np.testing.assert_allclose(space.physical(u), expected.physical(u), rtol=1e-6)
        np.testing.assert_allclose(space.unit(space.physical(u)), u, atol=1e-6)

    def trained(task):
        return jax.jit(lambda u: task.train(key, gaussian(task.space, u), task.init_policy(key)))(u)

    np.testing.assert_allclose(
        trained(moved).gain, trained(other).gain, rtol=2e-4
    )  # float32 Riccati
    seen = jax.jit(lambda p: moved.observe(moved.rollout(key, p, target)))(trained(moved))
    assert seen.shape == (moved.obs_dim,)


def test_offset_may_be_traced():
    make = shiftable_pendulum(PLAIN)

    def physical(offset):
        return make(offset).space.physical(jnp.full(4, 0.5))

    offsets = jnp.stack([jnp.zeros(4), jnp.asarray(OFFSET)])
    np.testing.assert_allclose(jax.jit(jax.vmap(physical))(offsets)[:, 1], [1.5, 1.8], rtol=1e-6)


@pytest.mark.slow
def test_phase_1_and_2_take_a_traced_offset():
    """Traced and not run: that all of it is one program for every range."""
    config = TrainConfig(
        task={"scaling": "paper"}, phase1=Phase1Config(trajectories=50, parallel=50, updates=1)
    )
    run = adaptsim_run(config, np.array([1.8, 0.3, 1.5, 1.5]), starts=3, iterations=4)
    shape = jax.eval_shape(run, jnp.asarray(OFFSET), jnp.asarray(0)).shape
    assert shape == (3, 5, 4)
