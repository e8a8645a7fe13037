"""The posterior by sbi beside SysID-Bayes as it is, on the pendulum's own simulations; failures
masked.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.baselines import mdn
from adaptsim_jax.baselines.steps_search import npe
from adaptsim_jax.baselines.sysid import SysIdConfig, mixture_estimator, simulate
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.space import Gaussian
from adaptsim_jax.tasks.registry import make_task

CONFIG = SysIdConfig(simulations=1000, first_fit=mdn.FitConfig(updates=1500))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_it_agrees_with_sysid_bayes_on_the_pendulum():
    pytest.importorskip("sbi", reason="sbi is an extra")
    task = make_task("pendulum", {})
    D = task.space.dim
    policy_key, train_key, data_key, fit_key, real_key, init_key = jax.random.split(
        jax.random.key(0), 6
    )
    policy = task.train(
        train_key, Gaussian(jnp.full(D, 0.5), jnp.full(D, 1e-3)), task.init_policy(policy_key)
    )
    x, u = jax.jit(lambda k, p: simulate(k, task, p, CONFIG))(data_key, policy)
    network = mixture_estimator(D, CONFIG)
    shift, scale = mdn.standardise(x)
    fitted = mdn.fit(
        fit_key,
        network.init(init_key, task.obs_dim),
        network.loss,
        (x - shift[None]) / scale[None],
        u,
        CONFIG.first_fit,
    )
    broken = np.asarray(x).copy()
    broken[:50, 0] = np.nan  # simulations that failed
    sample = npe(np.asarray(u), broken, seed=0)
    for place in (0.3, 0.6):
        truth = np.full(D, place, np.float32)
        real = task.observe(task.rollout(real_key, policy, task.space.physical(jnp.asarray(truth))))
        ours = np.asarray(network.infer(init_key, fitted, (real - shift) / scale))
        theirs = sample(np.asarray(real), 1000)
        assert theirs.shape == (1000, D)
        spread = np.maximum(ours.std(0), theirs.std(0))
        assert (np.abs(ours.mean(0) - theirs.mean(0)) < 2.0 * spread + 0.02).all()
        assert (np.abs(theirs.mean(0) - truth) < 3.0 * theirs.std(0) + 0.05).all()
        assert (theirs.std(0) < 0.25).any()  # it learned something: the prior's is 0.29


def test_too_few_sound_simulations_are_told():
    pytest.importorskip("sbi", reason="sbi is an extra")
    with pytest.raises(BadInput, match="5 of 30 simulations are finite"):
        npe(np.zeros((30, 2)), np.concatenate([np.zeros((5, 3)), np.full((25, 3), np.nan)]), seed=0)
