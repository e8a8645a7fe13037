"""Training by the reward's own gradient draws anew for each thing that it draws."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.adaptation.analytic import Analytic, AnalyticConfig
from tests.adaptation.toy import make_toy


def test_a_policy_its_training_and_each_visit_have_keys_of_their_own():
    def rollout(key, policy, params):
        return jnp.concatenate([policy, jax.random.normal(key, (1,))])

    drawing = replace(
        make_toy(),
        obs_dim=3,
        init_policy=lambda key: jax.random.normal(key, (1,)),
        train=lambda key, dist, policy: jnp.concatenate([policy, jax.random.normal(key, (1,))]),
        rollout=rollout,
    )
    config = AnalyticConfig(trajectories=4, parallel=2, horizon=3, hidden=(4,))
    seen = []
    noted = replace(drawing, observe=lambda drawn: jax.debug.callback(seen.append, drawn) or drawn)
    phase = Analytic(noted, lambda drawn: drawn.sum(), config)
    with jax.disable_jit():
        phase.adapt(phase.init(jax.random.key(0)).weights, jnp.full((1, 2), 0.5), jnp.ones(2), 2)
    jax.effects_barrier()
    every = np.concatenate([np.ravel(x) for x in seen])
    assert every.size == 9 and len(np.unique(every)) == 9  # three of each of three visits
