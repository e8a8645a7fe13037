"""The best policy whose parameters lie within Omega, by exhaustive search; Table 1's upper
normaliser.
"""

from itertools import product
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy import optimize

from adaptsim_jax.baselines.problem import Problem
from adaptsim_jax.core.errors import BadInput


class Best(NamedTuple):
    """For `T` targets: `mean [T, D]` (unit coordinates) whose policy does best, its `cost [T]`, the
    grid's best `[T]`.
    """

    mean: np.ndarray
    cost: np.ndarray
    grid_cost: np.ndarray


def best_in_omega(
    problem: Problem, targets: np.ndarray, *, points: int = 9, starts: int = 3
) -> Best:
    """For each of `targets [T, D]` (physical): all of a grid with `points` a side, then refined
    from the best `starts`.

    Double precision. The policies of the grid are solved once for all targets; the refinement is
    L-BFGS-B within the box, with the gradient through the Riccati solve and the rollout (the
    valleys are too narrow for a pattern search).
    """
    if points < 2 or starts < 1:
        raise BadInput(
            f"best in Omega with {points} points a side and {starts} starts: give at least 2 and 1"
        )
    grid = np.array(list(product(np.linspace(0.0, 1.0, points), repeat=problem.space.dim)))
    with jax.enable_x64(True):
        targets = np.asarray(targets, np.float64)
        policies = jax.jit(jax.vmap(lambda u: problem.policy(problem.space.physical(u))))(
            jnp.asarray(grid)
        )
        on_grid = jax.jit(jax.vmap(jax.vmap(problem.cost, (None, 0)), (0, None)))
        costs = np.asarray(on_grid(jnp.asarray(targets), policies))
        ends = [
            _best_of(problem, target, cost, grid, starts)
            for target, cost in zip(targets, costs, strict=True)
        ]
    return Best(
        np.array([mean for mean, _ in ends]),
        np.array([cost for _, cost in ends]),
        costs.min(axis=1),
    )


def _best_of(
    problem: Problem, target: np.ndarray, costs: np.ndarray, grid: np.ndarray, starts: int
):
    """Mean `[D]` and cost of the best of the grid's `starts` best points after refinement."""
    order = np.argsort(costs)[:starts]
    best = grid[order[0]], float(costs[order[0]])
    slope = jax.jit(problem.slope)
    for i in order:
        end = _refine(slope, grid[i], target, best[1])
        if end.fun * best[1] < best[1]:
            best = end.x, float(end.fun * best[1])
    return best


def _refine(slope, start: np.ndarray, target: np.ndarray, scale: float) -> optimize.OptimizeResult:
    def both(u):
        value, gradient = slope(u, target)
        return float(value) / scale, np.asarray(gradient, np.float64) / scale

    bounds = [(0.0, 1.0)] * len(start)
    options = {"ftol": 1e-14, "gtol": 1e-9}
    return optimize.minimize(
        both, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options
    )
