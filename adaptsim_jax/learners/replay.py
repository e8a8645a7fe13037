"""A first-in first-out replay of fixed size, written in whole blocks.

The write position is an argument and not part of the state: under `vmap` over seeds it stays
unbatched, so that a write is one contiguous window for all of them. `benchmarks/phase1.py --replay`
measures it beside flashbax.
"""

from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jax import Array

from adaptsim_jax.core.errors import BadInput

Items = TypeVar("Items")


class Transition(NamedTuple):
    """One adaptation step, or a batch of them.

    obs: `[..., obs_dim]`, action: `[..., branches]` int32, reward: `[...]`, next_obs: `[...,
        obs_dim]`,
    bootstrap: `[...]`, 0 where nothing follows and 1 elsewhere.
    """

    obs: Array
    action: Array
    reward: Array
    next_obs: Array
    bootstrap: Array


def check_capacity(capacity: int, block: int) -> None:
    """Blocks must tile the ring, else a write would run over its end and `dynamic_update_slice`
    would shift it.
    """
    if capacity % block or capacity < block:
        near = max(block, round(capacity / block) * block)
        raise BadInput(
            f"replay capacity {capacity} is not a multiple of the {block} items written at once; "
            f"use {near}"
        )


def empty(example: Items, capacity: int) -> Items:
    """A ring `[capacity, ...]` of zeros for items shaped like `example` (arrays or shapes with
    dtypes).
    """
    return jax.tree.map(lambda x: jnp.zeros((capacity, *x.shape), x.dtype), example)


def write(ring: Items, block: Items, count: Array) -> Items:
    """Write the `count`-th block `[block, ...]` (counted from 0) over the oldest items."""

    def put(store, new):
        start = (count * new.shape[0]) % store.shape[0]
        return jax.lax.dynamic_update_slice_in_dim(store, new.astype(store.dtype), start, axis=0)

    return jax.tree.map(put, ring, block)


def sample(key: Array, ring: Items, filled: Array, shape: tuple[int, ...]) -> Items:
    """Draw `[*shape, ...]` items uniformly with replacement from the first `filled` places."""
    index = jax.random.randint(key, shape, 0, filled)
    return jax.tree.map(lambda store: jnp.take(store, index, axis=0), ring)
