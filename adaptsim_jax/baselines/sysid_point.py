"""SysID-Point: one parameter vector regressed from the target's trajectory (paper, section 6)."""

from collections.abc import Callable
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import optax

from adaptsim_jax.baselines.sysid import Estimator, SysIdConfig, make_sysid
from adaptsim_jax.tasks.base import Task


class PointNetwork(nn.Module):
    """Observation `[obs]` (standardised) to unit coordinates `[dim]`, held within the box by a
    sigmoid.
    """

    dim: int
    hidden: tuple[int, ...] = (128, 128)

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        for width in self.hidden:
            x = nn.tanh(nn.Dense(width)(x))
        return nn.sigmoid(nn.Dense(self.dim)(x))


def point_estimator(dim: int, config: SysIdConfig) -> Estimator:
    """Smooth-L1 regression; infers the one point that it regresses to."""
    network: Any = PointNetwork(dim, config.hidden)

    def init(key: jax.Array, obs_dim: int) -> Any:
        return network.init(key, jnp.zeros(obs_dim))

    def loss(variables: dict, x: jax.Array, u: jax.Array) -> jax.Array:
        return jnp.mean(optax.huber_loss(network.apply(variables, x), u, delta=1.0))

    def infer(key: jax.Array, variables: dict, x: jax.Array) -> jax.Array:
        del key
        return network.apply(variables, x)[None]

    return Estimator(init, loss, infer)


def make_sysid_point(task: Task, config: SysIdConfig = SysIdConfig()) -> Callable:  # noqa: B008
    """`adapt(key, target [D] physical) -> Identified`; the policy is trained at the newest
    point.
    """
    return make_sysid(task, point_estimator(task.space.dim, config), config)
