"""A flax network over one flat vector of weights, so that rings, archives and checkpoints hold
plain arrays.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import linen as nn
from jax.flatten_util import ravel_pytree


def flat(
    network: nn.Module, obs_dim: int
) -> tuple[Callable[[jax.Array], jax.Array], Callable[..., Any]]:
    """`init(key) -> weights [n]` and `apply(weights, obs [..., obs_dim])` of a network."""
    example = jnp.zeros((1, obs_dim))
    # shapes only: running the initialisation here would compile it operation by operation
    shapes = jax.eval_shape(network.init, jax.random.key(0), example)
    unravel = ravel_pytree(jax.tree.map(lambda x: np.zeros(x.shape, x.dtype), shapes))[1]
    return lambda key: ravel_pytree(network.init(key, example))[
        0
    ], lambda weights, obs: network.apply(unravel(weights), obs)
