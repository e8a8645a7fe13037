"""The exact maximiser of a concave quadratic inside a box: what NAF's greedy action is when actions
have bounds.

Maximise `-(a - mean)' P (a - mean) / 2` with `P = L L'` positive definite over `low <= a <= high`.
Clipping `mean` is not the answer unless P is diagonal: a bound on one action moves the best value
of the others.
"""

from typing import Any

import jax
import jax.numpy as jnp

from adaptsim_jax.control.small_matrix import solve

Array = Any
# per action; 1 settles every one of 10,000 random problems of 3 actions, 4 all but one of 6 actions
ROUNDS = 6


def box_maximiser(mean: Array, chol: Array, low: float = -1.0, high: float = 1.0) -> Array:
    """`[..., d]`: the best action in `[low, high]^d` for `mean [..., d]` and lower-triangular `chol
    [..., d, d]`.

    d = 1 is a clip, d = 2 an enumeration of the active sets, d > 2 an active-set ascent.
    """
    d = mean.shape[-1]
    if d == 1:
        return jnp.clip(mean, low, high)
    precision = _precision(chol)
    if d == 2:
        return _two(mean, precision, low, high)
    return _many(mean, precision, low, high)


def _precision(chol: Array) -> Array:
    """`P = L L'`, summed by hand: a batched product of 2x2 matrices is slow in XLA."""
    return jnp.sum(chol[..., :, None, :] * chol[..., None, :, :], -1)


def _loss(delta: Array, precision: Array) -> Array:
    """`delta' P delta / 2`, `[...]`."""
    return 0.5 * jnp.sum(delta * jnp.sum(precision * delta[..., None, :], -1), -1)


def _two(mean: Array, precision: Array, low: float, high: float) -> Array:
    """The mean where it lies inside, else the best point of the four edges: on each the other
    action is a clip.
    """
    best, lowest = mean, jnp.where(jnp.all((mean >= low) & (mean <= high), -1), -1.0, jnp.inf)
    for i, j in ((0, 1), (1, 0)):
        slope = precision[..., 0, 1] / precision[..., j, j]
        for bound in (low, high):
            fixed = jnp.full_like(mean[..., i], bound)
            free = jnp.clip(mean[..., j] - slope * (fixed - mean[..., i]), low, high)
            action = jnp.stack((fixed, free) if i == 0 else (free, fixed), -1)
            loss = _loss(action - mean, precision)
            best = jnp.where((loss < lowest)[..., None], action, best)
            lowest = jnp.minimum(loss, lowest)
    return best


def _many(mean: Array, precision: Array, low: float, high: float) -> Array:
    """Rounds of two monotone moves until the active set settles.

    A sweep of coordinate ascent takes up and lets go of bounds. Then all free actions move together
    to where they would be best with the others held, as far as the first bound that they meet.
    """
    d = mean.shape[-1]

    def sweep(action):
        for i in range(d):
            row = precision[..., i, :]
            pull = jnp.sum(row * (action - mean), -1) - row[..., i] * (
                action[..., i] - mean[..., i]
            )
            action = action.at[..., i].set(jnp.clip(mean[..., i] - pull / row[..., i], low, high))
        return action

    def one(_, action):
        action = sweep(action)
        move = _solve_free(action, mean, precision, low, high) - action
        room = jnp.where(move > 0, high - action, low - action)
        share = jnp.where(move == 0, 1.0, room / jnp.where(move == 0, 1.0, move))
        return jnp.clip(action + jnp.minimum(share.min(-1, keepdims=True), 1.0) * move, low, high)

    return jax.lax.fori_loop(0, ROUNDS * d, one, jnp.clip(mean, low, high))


def _solve_free(action: Array, mean: Array, precision: Array, low: float, high: float) -> Array:
    """Stationary point of the actions that touch no bound, the others held: `P_ff (a_f - m_f) =
    -P_fb (b - m_b)`.
    """
    free = (action > low) & (action < high)
    held = jnp.where(free, 0.0, action - mean)
    right = -jnp.sum(precision * held[..., None, :], -1)
    eye = jnp.broadcast_to(jnp.eye(mean.shape[-1], dtype=mean.dtype), precision.shape)
    matrix = jnp.where(free[..., :, None] & free[..., None, :], precision, eye)

    def last(x, n):
        return jnp.moveaxis(x, tuple(range(x.ndim - n)), tuple(range(n - x.ndim, 0)))

    found = solve(last(matrix, 2), last(jnp.where(free, right, 0.0), 1)[:, None])[:, 0]
    return jnp.where(free, mean + jnp.moveaxis(found, 0, -1), action)
