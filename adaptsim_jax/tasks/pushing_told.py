"""What the target's own pushes tell beside the parameters: how far the simulator at E's mean is off, over the actions.

No E makes the simulator right where the target is of another kind, nor where E is not found yet. The pushes that adaptation makes
anyway show by how much: each is simulated again at the E in question, and what it differs by is smoothed over the actions by a
Gaussian process (Rasmussen and Williams 2006, chapter 2). Far from all pushes the simulator is believed as it is.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

_REACH = 0.5  # of the action's range [-1, 1]: how far what a push showed holds
_DOUBT = 0.1  # noise's share of the gaps' spread: a gap is one of a simulator with edges, not of a smooth function


class Told(NamedTuple):
    """Pushes made in the target: actions `[K, 2]` in [-1, 1], places `[K, 2]` m where their bottles ended, used `[K]` bool:
    whether a row counts."""

    actions: jax.Array
    places: jax.Array
    used: jax.Array


def with_gaps(push: Callable[[jax.Array], jax.Array], told: Told) -> Callable[[jax.Array], jax.Array]:
    """`push(action [2] in [-1, 1]) -> [2]` m, mended by what the target's pushes differ from it by. Rows that are not used, or
    not finite, count for nothing; without any it is `push` itself."""
    used = told.used & jnp.isfinite(told.places).all(-1)
    gaps = jnp.where(used[:, None], told.places - jax.vmap(push)(told.actions), 0.0)
    alike = _alike(told.actions, told.actions) * used[:, None] * used[None]
    spread = alike + jnp.diag(jnp.where(used, _DOUBT**2, 1.0))
    weights = jax.scipy.linalg.solve(spread, gaps, assume_a="pos")
    return lambda action: push(action) + (_alike(action[None], told.actions) @ weights)[0]


def _alike(a: jax.Array, b: jax.Array) -> jax.Array:
    """`[A, 2], [B, 2] -> [A, B]`: 1 for the same action, 0 for far ones."""
    return jnp.exp(-0.5 * jnp.sum(((a[:, None] - b[None]) / _REACH) ** 2, -1))
