"""What the target's own pushes tell beside the choice of E: how far the simulator at E's mean is
off, over parameters and actions.

No E makes the simulator right where the target is of another kind, nor where E is not found yet.
The pushes that adaptation makes anyway show by how much: each is simulated again at the E in
question. What near parameters within Omega explain of the gaps is taken for granted (`nearer`), and
what they leave is smoothed over the actions by a Gaussian process (Rasmussen and Williams 2006,
chapter 2; `with_gaps`). Far from all pushes the simulator is believed as it is.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

_REACH = 0.5  # of the action's range [-1, 1]: how far what a push showed holds
# noise's share of the gaps' spread: a gap is one of a simulator with edges, not of a smooth
# function
_DOUBT = 0.1
_NEAR = 0.15  # of Omega's range: how far from E's mean parameters are looked for
_BLUR, _LARGE = (
    0.01,
    3.0,
)  # m: what counts as a gap; and gaps so many times larger count less than their square
_STEPS, _AHEAD, _LEAP = (
    6,
    0.04,
    0.2,
)  # steps; of Omega's range: of a slope by differences, and the farthest of one step
_DAMPING = (0.1, 0.3, 5.0)  # of the steps: at first, and its factors after a success and a failure


class Told(NamedTuple):
    """Pushes made in the target: actions `[K, 2]` in [-1, 1], places `[K, 2]` m where their bottles
    ended, used `[K]` bool: whether a row counts.
    """

    actions: jax.Array
    places: jax.Array
    used: jax.Array


def nearer(
    end: Callable[[jax.Array, jax.Array], jax.Array],
    mean: jax.Array,
    told: Told,
    guide: Callable[[jax.Array, jax.Array], jax.Array] | None = None,
) -> jax.Array:
    """E's `mean [D]` (unit coordinates) moved within Omega to where `end(u [D], action [2]) -> [2]`
    m puts the target's pushes best.

    A few damped steps of Gauss and Newton (Levenberg, Marquardt) under a Gaussian prior of width
    `_NEAR` around `mean`, with slopes by central differences, for a push that touches the patch's
    edge has none. Without pushes it is `mean` itself. `guide`: a cheaper simulator, alike, that
    slopes are taken from.
    """
    used = told.used & jnp.isfinite(told.places).all(-1)
    places = jnp.where(used[:, None], told.places, 0.0)
    step = _AHEAD * jnp.eye(mean.shape[0], dtype=mean.dtype)

    def miss(u, end=end):
        gap = (
            jnp.where(used[:, None], jax.vmap(lambda a: end(u, a))(told.actions) - places, 0.0)
            / _BLUR
        )
        return (gap / (1.0 + jnp.sum(gap**2, -1, keepdims=True) / _LARGE**2) ** 0.25).reshape(-1)

    about = miss if guide is None else lambda u: miss(u, guide)

    def cost(u, missed):
        return missed @ missed + jnp.sum(((u - mean) / _NEAR) ** 2)

    def one(carry, _):
        u, missed, damping = carry
        slope = jax.vmap(lambda s: (about(u + s) - about(u - s)) / (2 * _AHEAD))(step).T
        curve = slope.T @ slope + jnp.eye(len(mean)) / _NEAR**2
        down = slope.T @ missed + (u - mean) / _NEAR**2
        away = jnp.linalg.solve(curve + damping * jnp.diag(jnp.diag(curve)), down)
        tried = jnp.clip(u - jnp.clip(away, -_LEAP, _LEAP), 0.0, 1.0)
        now = miss(tried)
        better = cost(tried, now) < cost(u, missed)
        damping = damping * jnp.where(better, _DAMPING[1], _DAMPING[2])
        return (jnp.where(better, tried, u), jnp.where(better, now, missed), damping), None

    begin = (mean, miss(mean), jnp.asarray(_DAMPING[0], mean.dtype))
    return jax.lax.scan(one, begin, length=_STEPS)[0][0]


def with_gaps(
    push: Callable[[jax.Array], jax.Array], told: Told
) -> Callable[[jax.Array], jax.Array]:
    """`push(action [2] in [-1, 1]) -> [2]` m, mended by what the target's pushes differ from it by.
    Rows that are not used, or not finite, count for nothing; without any it is `push` itself.
    """
    used = told.used & jnp.isfinite(told.places).all(-1)
    gaps = jnp.where(used[:, None], told.places - jax.vmap(push)(told.actions), 0.0)
    alike = _alike(told.actions, told.actions) * used[:, None] * used[None]
    spread = alike + jnp.diag(jnp.where(used, _DOUBT**2, 1.0))
    weights = jax.scipy.linalg.solve(spread, gaps, assume_a="pos")
    return lambda action: push(action) + (_alike(action[None], told.actions) @ weights)[0]


def _alike(a: jax.Array, b: jax.Array) -> jax.Array:
    """`[A, 2], [B, 2] -> [A, B]`: 1 for the same action, 0 for far ones."""
    return jnp.exp(-0.5 * jnp.sum(((a[:, None] - b[None]) / _REACH) ** 2, -1))
