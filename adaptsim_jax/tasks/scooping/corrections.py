"""What the target's own scoops tell beside the parameters: how far the chance of success at E's
mean is off, over the actions.

No E makes the bank right where the target is a piece that Omega does not have, nor where the bank
itself is too hopeful, nor where E is not found yet. The scoops that adaptation makes anyway show
it: Their outcomes are taken for coins whose log odds are the bank's at E's mean and a Gaussian
process (Rasmussen and Williams 2006, chapter 3, Laplace's approximation). Its covariance is of two
parts: Departures towards other pieces, for what pieces have in common the bank knows; and smooth
ones over the actions, for what it has wrong of all. Where the piece lies changes nothing, and is
left out.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

_STEPS = 30  # towards the mode: each of them comes nearer, whatever the outcomes


class ScoopRecord(NamedTuple):
    """Scoops made in the target: actions `[K, 3]` in [-1, 1] as asked for, won `[K]` (1 or 0), used
    `[K]` bool: whether a row counts.
    """

    actions: Array
    won: Array
    used: Array


class Doubt(NamedTuple):
    """Of what the bank's log odds at E's mean may be off by. others: Share of the way to other
    pieces' that the target may be. reach: Of the action's range [-1, 1], how far else what a scoop
    showed holds. spread: Standard deviation of that. most: Log odds that the bank never goes
    beyond. Chosen on pieces and seeds that no table uses.
    """

    others: float = 1.0
    reach: float = 0.5
    spread: float = 1.0
    most: float = 3.0


class Odds(NamedTuple):
    """The bank's log odds of success of `A` actions: at E's mean `expected [A]`, and at `J` other
    pieces `others [A, J]`.
    """

    expected: Array
    others: Array


def chances(
    trials: ScoopRecord, at_reported: Odds, tried: Array, at_tried: Odds, doubt: Doubt = Doubt()
) -> Array:
    """`[A]`, chance of success of the actions `tried [A, 3]` as `outlook` has it. Unsure odds are
    drawn towards even, as their expected chance is.
    """
    odds, variance = outlook(trials, at_reported, tried, at_tried, doubt)
    return jax.nn.sigmoid(odds / jnp.sqrt(1.0 + np.pi / 8.0 * variance))


def outlook(
    trials: ScoopRecord,
    at_reported: Odds,
    tried: Array,
    at_tried: Odds,
    doubt: Doubt = Doubt(),
) -> tuple[Array, Array]:
    """Log odds of success `[A]` of the actions `tried [A, 3]` by the bank and by what was seen in
    the target, `told`, and their variance `[A]`; `at_reported`, `at_tried`: the bank's odds of
    both. Rows that are not used count for nothing.
    """
    used = trials.used.astype(tried.dtype)
    prior, ways = _departures(at_reported, doubt)
    alike = (
        _covariance(ways, trials.actions, ways, trials.actions, doubt) * used[:, None] * used[None]
    )
    pull = _mode(prior, alike, trials.won, used)
    at_mode = jax.nn.sigmoid(prior + alike @ pull)
    root = jnp.sqrt(at_mode * (1.0 - at_mode) * used)
    there, tried_ways = _departures(at_tried, doubt)
    across = _covariance(tried_ways, tried, ways, trials.actions, doubt) * used[None]
    known = jax.scipy.linalg.solve_triangular(
        _factor(root, alike), root[:, None] * across.T, lower=True
    )
    alone = doubt.spread**2 + jnp.sum(tried_ways**2, 1)
    return there + across @ pull, jnp.maximum(alone - jnp.sum(known**2, 0), 0.0)


def lattice(count: int) -> np.ndarray:
    """`[count, 3]` actions in [-1, 1], spread evenly: a lattice of irrational steps."""
    return (
        2.0
        * ((np.arange(count)[:, None] + 0.5) * np.array([0.8191725, 0.6710436, 0.5497005]) % 1.0)
        - 1.0
    )


def _departures(odds: Odds, doubt: Doubt) -> tuple[Array, Array]:
    """Odds at E's mean `[A]`, bounded, and the ways `[A, J]` in which those of the other pieces
    depart from them.
    """

    def held(x):
        return doubt.most * jnp.tanh(x / doubt.most)

    expected, others = held(odds.expected), held(odds.others)
    return expected, doubt.others * (others - expected[:, None]) / np.sqrt(max(others.shape[1], 1))


def _covariance(ways_a, a, ways_b, b, doubt: Doubt) -> Array:
    """`[A, B]`: what pieces make actions share, and what near actions do."""
    return ways_a @ ways_b.T + doubt.spread**2 * _alike(a, b, doubt.reach)


def _mode(prior: Array, alike: Array, won: Array, used: Array) -> Array:
    """`[K]`, inverse covariance times the likeliest departure from `prior [K]`, by the bound of
    Jaakkola and Jordan (2000).
    """

    def nearer(pull, _):
        odds = prior + alike @ pull
        small = jnp.abs(odds) < 1e-3
        slope = jnp.where(small, 0.25, 0.5 * jnp.tanh(0.5 * odds) / jnp.where(small, 1.0, odds))
        weight = slope * used
        root = jnp.sqrt(weight)
        drive = (won - 0.5) * used - weight * prior
        inner = jax.scipy.linalg.cho_solve((_factor(root, alike), True), root * (alike @ drive))
        return drive - root * inner, None

    return jax.lax.scan(nearer, jnp.zeros_like(prior), length=_STEPS)[0]


def _factor(root: Array, alike: Array) -> Array:
    """Cholesky factor of `1 + root alike root`."""
    return jnp.linalg.cholesky(
        jnp.eye(len(root), dtype=alike.dtype) + root[:, None] * alike * root[None]
    )


def _alike(a: Array, b: Array, reach: float) -> Array:
    """`[A, 3], [B, 3] -> [A, B]`: 1 for the same action, 0 for far ones."""
    return jnp.exp(-0.5 * jnp.sum(((a[:, None] - b[None]) / reach) ** 2, -1))
