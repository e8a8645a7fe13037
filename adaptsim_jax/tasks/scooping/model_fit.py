"""A smoothed chance of success, and its gradient.

The engine's derivatives are exact, and right for as long as a motion is not chaotic. That of a
round piece may not be at all. A flat bottom with the blade's edge under it is, every contact
multiplies the derivative, and by the end of a trial it may be 1e10 times what a change of any size
that matters does (`experiments/scooping_gradient.py`, which fits a modulus to the early part of a
track with the engine's own derivative). So the chance of success, which a step decides at the end,
is smoothed over a spread of its inputs and differentiated with the score-function estimator, which
needs outcomes alone.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.tasks.scooping import hydro
from adaptsim_jax.tasks.scooping.hydro import Numerics
from adaptsim_jax.tasks.scooping.model import ScoopOptions

Array = Any
RANGES = (0.15, float(np.log(50.0)), 0.01, float(np.radians(8.0)), 0.4, 0.015)
"""Omega's and the actions' ranges: friction, log modulus, height m, pitch rad, rate rad/s, distance
m.
"""


class Smoothed(NamedTuple):
    """chance `[]` of success over the spread of inputs; gradient `[6]` of it and its standard error
    `[6]`, by the inputs' ranges: friction, log modulus, height, pitch, rate, distance.
    """

    chance: Array
    gradient: Array
    error: Array


def scaled(params: Array, action: Array) -> Array:
    """`[6]`: the inputs of `Smoothed`, in shares of Omega's and the actions' ranges."""
    return jnp.stack([params[0], jnp.log(params[1]), params[3], *action]) / jnp.asarray(
        RANGES, params.dtype
    )


def unscaled(z: Array, shape: Array) -> tuple[Array, Array]:
    """`(params [4], action [3])` of `z [6]`, the inverse of `scaled`; pitch and distance stay above
    0.
    """
    v = z * jnp.asarray(RANGES, z.dtype)
    minimum = jnp.asarray([1e-3, -1.0, 1e-3], z.dtype)
    return jnp.stack([v[0], jnp.exp(v[1]), shape, v[2]]), jnp.maximum(v[3:], minimum)


def smoothed(
    key: Array,
    params: Array,
    action: Array,
    *,
    spread: float = 0.1,
    pairs: int = 256,
    options: ScoopOptions = ScoopOptions(),  # noqa: B008
    numerics: Numerics = Numerics(),  # noqa: B008
) -> Smoothed:
    """Chance of success with normal errors of `spread` (a share of the ranges) on all inputs, and
    its gradient, from `pairs` of trials on both sides: `E[success(z + s n) n] / s`. Pure; jit it.
    """
    z = scaled(params, action)
    n = jax.random.normal(key, (pairs, len(RANGES)), z.dtype)

    def won(at):
        return hydro.rollout(*unscaled(at, params[2]), options, numerics).success

    up, down = jax.vmap(won)(z[None] + spread * n), jax.vmap(won)(z[None] - spread * n)
    each = (up - down)[:, None] * n / (2 * spread)
    return Smoothed((up + down).mean() / 2, each.mean(0), each.std(0) / np.sqrt(pairs))
