"""The ceiling of AdaptSim's step grid: the best mean that fixed steps reach from a start within the
horizon.
"""

from itertools import combinations

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.baselines.bounds import ExactProblem


def reachable_values(start: float, delta: float, steps: int) -> np.ndarray:
    """All values in [0, 1] that one parameter reaches from `start` in at most `steps` moves of 0 or
    +-`delta`, clipped.

    Clipping at an end shifts the grid, so this is more than `start + k delta`.
    """
    seen, frontier = {round(start, 12)}, {round(start, 12)}
    for _ in range(steps):
        frontier = {
            round(min(max(v + d, 0.0), 1.0), 12) for v in frontier for d in (-delta, delta)
        } - seen
        seen |= frontier
    return np.array(sorted(seen))


def ceiling(
    problem: ExactProblem,
    starts: np.ndarray,
    target: np.ndarray,
    goal: np.ndarray,
    *,
    delta: float,
    steps: int,
):
    """Best reachable `(means [S, D], costs [S])` in `target [D]` from each of `starts [S, D]`, in
    double precision.

    Searches the reachable grid exhaustively over pairs of parameters in turn, from the grid point
    nearest to `goal [D]` (the best mean of Omega), until no pair improves: a lower bound of the
    ceiling, and tight where it was checked in full.
    """
    with jax.enable_x64(True):
        cost = jax.jit(jax.vmap(problem.cost_at, (0, None)))
        found = [
            _search(cost, s, target, goal, delta, steps) for s in np.asarray(starts, np.float64)
        ]
    return np.array([u for u, _ in found]), np.array([c for _, c in found])


def _search(cost, start, target, goal, delta, steps):
    values = [reachable_values(float(s), delta, steps) for s in start]
    u = np.array([v[np.argmin(np.abs(v - g))] for v, g in zip(values, goal, strict=True)])
    best = np.inf
    while True:
        before = best
        for i, j in combinations(range(len(u)), 2):
            u, best = _best_pair(cost, u, best, target, i, j, values)
        if not best < before:
            return u, best


def _best_pair(cost, u, best, target, i, j, values):
    a, b = np.meshgrid(values[i], values[j], indexing="ij")
    size = (
        32**2
        # one shape, so that one compiled program serves all: no parameter reaches more than 32
        # values
    )
    tried = np.tile(u, (max(size, a.size), 1))
    tried[: a.size, i], tried[: a.size, j] = a.ravel(), b.ravel()
    costs = np.asarray(cost(jnp.asarray(tried), jnp.asarray(target)))
    k = int(np.argmin(costs))
    return (tried[k], float(costs[k])) if costs[k] < best else (u, best)
