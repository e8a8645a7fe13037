"""Phase 1 of the push with the MuJoCo scene in MJX as its simulator."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.adaptation.phase1 import Phase1Config, make_phase1
from adaptsim_jax.adaptation.presets import PRESETS
from adaptsim_jax.adaptation.reuse import ReuseConfig
from adaptsim_jax.adaptation.training import traced
from adaptsim_jax.tasks.pushing import model
from adaptsim_jax.tasks.pushing.engines.registry import make_backend
from adaptsim_jax.tasks.pushing.simulator import make_guide, make_simulator
from adaptsim_jax.tasks.pushing.task import PushingConfig
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
    assert np.abs(np.asarray(found) - expected).max() < 0.002  # m; MJX in float32, docs/results/pushing_parity.md


@pytest.mark.slow
def test_phase_1_runs_in_it():
    """Policies made, refined and rehearsed in MJX; what is learned in two rounds is not looked at."""
    config = PRESETS["mjx-pushing"]()
    task = make_task(
        "pushing", config.task | {"duration": 0.65, "shared": {"contexts": 8, "trials": 4, "candidates": 4}}
    )
    sizes = Phase1Config(
        trajectories=8, parallel=4, horizon=2, updates=2, batch=8, capacity=16, archive=16, hidden=(8,),
        reuse=ReuseConfig(threshold=9.0, first=2000, most=3000, least=1000, capacity=4, together=4),
    )  # fmt: skip
    phase1 = make_phase1(task, sizes)
    state, info = jax.jit(phase1.run)(jax.jit(phase1.init)(jax.random.key(0)), traced(config.hyper), jnp.arange(2))
    assert np.all((info.reward >= 0) & (info.reward <= 1)) and info.reward.mean() > 0
    assert np.isfinite(state.learner.target).all()
