"""What the target's own scoops tell beside the parameters: how far the chance of success at E's mean is off, over the actions.

No E makes the bank right where the target is a piece that Omega does not have, nor where the bank itself is too hopeful, nor
where E is not found yet. The scoops that adaptation makes anyway show it: their outcomes are taken for coins whose log odds are
the bank's at E's mean and a smooth function of the action, a Gaussian process (Rasmussen and Williams 2006, chapter 3, Laplace's
approximation). Far from all scoops the bank is believed, the less the bolder it is. Where the piece lies changes nothing, and is
left out.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

_STEPS = 30  # towards the mode: each of them comes nearer, whatever the outcomes


class Told(NamedTuple):
    """Scoops made in the target: actions `[K, 3]` in [-1, 1] as asked for, won `[K]` (1 or 0), used `[K]` bool: whether a row
    counts."""

    actions: jax.Array
    won: jax.Array
    used: jax.Array


class Doubt(NamedTuple):
    """reach: of the action's range [-1, 1], how far what a scoop showed holds; spread: standard deviation of what the bank's log
    odds may be off by; most: log odds that the bank never goes beyond. Chosen on pieces and seeds that no table uses."""

    reach: float = 0.5
    spread: float = 2.0
    most: float = 3.0


def with_outcomes(
    odds: Callable[[jax.Array], jax.Array],
    told: Told,
    doubt: Doubt = Doubt(),  # noqa: B008
) -> Callable[[jax.Array], jax.Array]:
    """`chance(action [3]) -> []` of success, from the bank's `odds(action) -> []` (log odds) and what was seen in the target.

    Rows that are not used count for nothing. Unsure odds are drawn towards even, as their expected chance is.
    """
    held = lambda a: doubt.most * jnp.tanh(odds(a) / doubt.most)
    used = told.used.astype(told.actions.dtype)
    prior = jax.vmap(held)(told.actions)
    alike = doubt.spread**2 * _alike(told.actions, told.actions, doubt.reach) * used[:, None] * used[None]
    pull = _mode(prior, alike, told.won, used)
    at_mode = jax.nn.sigmoid(prior + alike @ pull)
    root = jnp.sqrt(at_mode * (1.0 - at_mode) * used)
    factor = _factor(root, alike)

    def chance(action):
        near = doubt.spread**2 * _alike(action[None], told.actions, doubt.reach)[0] * used
        known = jax.scipy.linalg.solve_triangular(factor, root * near, lower=True)
        variance = jnp.maximum(doubt.spread**2 - known @ known, 0.0)
        return jax.nn.sigmoid((held(action) + near @ pull) / jnp.sqrt(1.0 + np.pi / 8.0 * variance))

    return chance


def best_action(
    chance: Callable[[jax.Array], jax.Array], known: jax.Array, points: int = 256, rounds: int = 3
) -> jax.Array:
    """`[3]` in [-1, 1], the likeliest of `known [F, 3]` and `points` spread evenly, then of a quarter as many around the best in each
    of `rounds` boxes, each half the one before."""
    spread = jnp.asarray(_lattice(points), known.dtype)
    near = jnp.asarray(_lattice(max(points // 4, 1)), known.dtype)
    tried = jnp.concatenate([known, spread])
    value = jax.vmap(chance)(tried)
    best, worth = tried[jnp.argmax(value)], jnp.max(value)
    for number in range(rounds):
        tried = jnp.clip(best[None] + 0.25 * 0.5**number * near, -1.0, 1.0)
        value = jax.vmap(chance)(tried)
        best = jnp.where(jnp.max(value) > worth, tried[jnp.argmax(value)], best)
        worth = jnp.maximum(worth, jnp.max(value))
    return best


def _mode(prior: jax.Array, alike: jax.Array, won: jax.Array, used: jax.Array) -> jax.Array:
    """`[K]`, inverse covariance times the likeliest departure from `prior [K]`, by the bound of Jaakkola and Jordan (2000)."""

    def nearer(pull, _):
        odds = prior + alike @ pull
        weight = (
            jnp.where(jnp.abs(odds) < 1e-3, 0.25, 0.5 * jnp.tanh(0.5 * odds) / jnp.where(odds == 0, 1.0, odds)) * used
        )
        root = jnp.sqrt(weight)
        drive = (won - 0.5) * used - weight * prior
        inner = jax.scipy.linalg.cho_solve((_factor(root, alike), True), root * (alike @ drive))
        return drive - root * inner, None

    return jax.lax.scan(nearer, jnp.zeros_like(prior), length=_STEPS)[0]


def _factor(root: jax.Array, alike: jax.Array) -> jax.Array:
    """Cholesky factor of `1 + root alike root`."""
    return jnp.linalg.cholesky(jnp.eye(len(root), dtype=alike.dtype) + root[:, None] * alike * root[None])


def _alike(a: jax.Array, b: jax.Array, reach: float) -> jax.Array:
    """`[A, 3], [B, 3] -> [A, B]`: 1 for the same action, 0 for far ones."""
    return jnp.exp(-0.5 * jnp.sum(((a[:, None] - b[None]) / reach) ** 2, -1))


def _lattice(count: int) -> np.ndarray:
    """`[count, 3]` in [-1, 1], spread evenly: a lattice of irrational steps."""
    return 2.0 * ((np.arange(count)[:, None] + 0.5) * np.array([0.8191725, 0.6710436, 0.5497005]) % 1.0) - 1.0
