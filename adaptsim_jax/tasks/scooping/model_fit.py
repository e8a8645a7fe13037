"""Derivatives through the scooping engine put to use: a smoothed chance of success, and a modulus fitted to a trajectory.

The engine's derivatives are exact, and right for as long as a motion is not chaotic. That of a round piece may not be at all; a
flat bottom with the blade's edge under it is, every contact multiplies the derivative, and by the end of a trial it may be 1e10
times what a change of any size that matters does (`experiments/scooping_gradient.py`). So a modulus is fitted to a track, or to
the early part of one, with the engine's own derivative, while the chance of success, which a step decides at the end, is smoothed
over a spread of its inputs and differentiated with the score-function estimator, which needs outcomes alone.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.tasks.scooping import hydro, model
from adaptsim_jax.tasks.scooping.hydro import Numerics
from adaptsim_jax.tasks.scooping.model import ScoopOptions

Array = Any
RANGES = (0.15, float(np.log(50.0)), 0.01, float(np.radians(8.0)), 0.4, 0.015)
"""Omega's and the actions' ranges: friction, log modulus, height m, pitch rad, rate rad/s, distance m."""
SHORTEST = 2.0**-10  # share of a Gauss-Newton step below which the search along it is given up


class ModulusFit(NamedTuple):
    """modulus Pa; error: root of the mean squared distance of the tracks m; steps: of Gauss-Newton; moduli: visited `[steps + 1]`."""

    modulus: float
    error: float
    steps: int
    moduli: list[float]


class Smoothed(NamedTuple):
    """chance `[]` of success over the spread of inputs; gradient `[6]` of it and its standard error `[6]`, by the inputs' ranges:
    friction, log modulus, height, pitch, rate, distance."""

    chance: Array
    gradient: Array
    error: Array


def scaled(params: Array, action: Array) -> Array:
    """`[6]`: the inputs of `Smoothed`, in shares of Omega's and the actions' ranges."""
    return jnp.stack([params[0], jnp.log(params[1]), params[3], *action]) / jnp.asarray(RANGES, params.dtype)


def unscaled(z: Array, shape: Array) -> tuple[Array, Array]:
    """`(params [4], action [3])` of `z [6]`, the inverse of `scaled`; pitch and distance stay above 0."""
    v = z * jnp.asarray(RANGES, z.dtype)
    least = jnp.asarray([1e-3, -1.0, 1e-3], z.dtype)
    return jnp.stack([v[0], jnp.exp(v[1]), shape, v[2]]), jnp.maximum(v[3:], least)


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
    """Chance of success with normal errors of `spread` (a share of the ranges) on all inputs, and its gradient, from
    `pairs` of trials on both sides: `E[success(z + s n) n] / s`. Pure; jit it."""
    z = scaled(params, action)
    n = jax.random.normal(key, (pairs, len(RANGES)), z.dtype)
    won = lambda at: hydro.rollout(*unscaled(at, params[2]), options, numerics).success
    up, down = jax.vmap(won)(z[None] + spread * n), jax.vmap(won)(z[None] - spread * n)
    each = (up - down)[:, None] * n / (2 * spread)
    return Smoothed((up + down).mean() / 2, each.mean(0), each.std(0) / np.sqrt(pairs))


def track_until(seconds: float, options: ScoopOptions, numerics: Numerics) -> Callable[[Array, Array], Array]:
    """`track(params [4], action [3]) -> [T, 3]`: the piece's x, z m and angle rad, a row a step, for the first `seconds`."""
    rows = round(seconds / numerics.dt) + 1
    return lambda params, action: hydro.rollout(params, action, options, numerics).piece[:rows]


def make_modulus_fit(
    seconds: float = 0.15,
    options: ScoopOptions = ScoopOptions(),  # noqa: B008
    numerics: Numerics = Numerics(),  # noqa: B008
    steps: int = 30,
) -> Callable[[np.ndarray, np.ndarray, np.ndarray], ModulusFit]:
    """`fit(seen [T, 2], params [4], action [3])`: the modulus with which the engine's track comes nearest to `seen` (x, z m) in a
    trial whose other numbers are known.

    Gauss-Newton on the logarithm of the modulus from `params[1]`, with the derivative of the engine; a step is halved until the
    error falls. `seconds`: how much of the track is used; with a flat bottom it must end soon after the blade met the piece.
    Runs in the precision that JAX is told to use; float64 is worth its time here.
    """
    track = track_until(seconds, options, numerics)
    low, high = np.log(model.PHYSICAL_LOW[1]), np.log(model.PHYSICAL_HIGH[1])

    def apart(log_modulus, seen, params, action):
        return (track(params.at[1].set(jnp.exp(log_modulus)), action)[:, :2] - seen).ravel()

    @jax.jit
    def both(z, *known):
        return jax.jvp(lambda q: apart(q, *known), (z,), (jnp.ones_like(z),))

    def fit(seen, params, action):
        known = tuple(jnp.asarray(v, jnp.result_type(float)) for v in (seen, params, action))
        at = lambda z: tuple(np.asarray(v, float) for v in both(jnp.asarray(z), *known))
        z = float(np.log(params[1]))
        (wrong, slope), visited = at(z), [float(np.exp(z))]
        for _ in range(steps):
            move = -float(slope @ wrong) / max(float(slope @ slope), 1e-30)
            move, share = float(np.clip(move, -1.5, 1.5)), 1.0
            while share > SHORTEST:
                new = float(np.clip(z + share * move, low, high))
                now = at(new)
                if now[0] @ now[0] < wrong @ wrong:
                    break
                share /= 2
            else:
                break
            z, (wrong, slope) = new, now
            visited.append(float(np.exp(z)))
        return ModulusFit(visited[-1], float(np.sqrt(np.mean(wrong**2))), len(visited) - 1, visited)

    return fit
