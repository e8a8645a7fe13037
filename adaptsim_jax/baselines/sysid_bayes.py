"""SysID-Bayes: BayesSim (Ramos et al., 2019), a mixture-density posterior over simulation
parameters.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from adaptsim_jax.baselines import mdn
from adaptsim_jax.baselines.sysid import Estimator, SysIdConfig, make_sysid
from adaptsim_jax.tasks.base import Task


def mixture_estimator(dim: int, config: SysIdConfig) -> Estimator:
    """Full-covariance mixture over unit coordinates; infers by drawing from it."""
    network: Any = mdn.MixtureNetwork(dim, config.components, config.hidden)

    def init(key: jax.Array, obs_dim: int) -> Any:
        return network.init(key, jnp.zeros(obs_dim))

    def loss(variables: dict, x: jax.Array, u: jax.Array) -> jax.Array:
        return -mdn.log_prob(network.apply(variables, x), u)

    def infer(key: jax.Array, variables: dict, x: jax.Array) -> jax.Array:
        return mdn.sample(key, network.apply(variables, x), config.draws)

    return Estimator(init, loss, infer)


def make_sysid_bayes(task: Task, config: SysIdConfig = SysIdConfig()) -> Callable:  # noqa: B008
    """`adapt(key, target [D] physical) -> Identified`; the policy follows the mean of the posterior
    within Omega.
    """
    return make_sysid(task, mixture_estimator(task.space.dim, config), config)
