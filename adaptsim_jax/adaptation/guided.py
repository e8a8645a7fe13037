"""Trajectories of Phase 1 that are led towards their target, for the adaptation policy to learn
from where they come.

Steps of single parameters, chosen for what they earn at once, end where parameters make up for each
other's errors; random exploration seldom leaves such places. In simulation the target's parameters
are known, so some trajectories may be walked towards them. Only what is tried changes: rewards are
the task's, and Phase 2 knows nothing of it.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from adaptsim_jax.learners.bdq import explore
from adaptsim_jax.space import MINUS, PLUS, STAY, Space

# share of a led trajectory's steps of single parameters that are random: others get a value, too
_ASTRAY = 0.3


class Guide(NamedTuple):
    """share: of trajectories that are led; space: Omega."""

    share: float
    space: Space

    def __call__(self, trajectory_key, step_key, action, mean, target, size) -> jax.Array:
        """The action `[D]` to take at `mean [D]` (unit coordinates) with steps of `size`: `action`,
        or one towards `target [D]` (physical), as `trajectory_key` has it for all of a trajectory.
        """
        led = jax.random.uniform(jax.random.fold_in(trajectory_key, 1)) < self.share
        towards = explore(
            jax.random.fold_in(step_key, 1),
            heading(self.space, mean, target, size),
            3,
            _ASTRAY,
            1.0,
        )
        return jnp.where(led, towards, action)


def heading(space: Space, mean: jax.Array, target: jax.Array, size: jax.Array | float) -> jax.Array:
    """`[D]` int32: the action that brings `mean [D]` nearer to `target [D]` (physical; its nearest
    point of Omega).
    """
    gap = jnp.clip(space.unit(target), 0.0, 1.0) - mean
    return jnp.where(jnp.abs(gap) < size / 2, STAY, jnp.where(gap < 0, MINUS, PLUS)).astype(
        jnp.int32
    )
