"""Normalisers of tasks whose policy is solved exactly: UDR is 0, the best in Omega 1 (paper, Table
1); and the map of rewards of figure 5.

UDR is one policy for all of Omega, by minimising the mean cost (paper, section 6). Which cost
matters. Eight free gains and a single start state overfit: gains go into the thousands on a
coordinate that this start hardly excites. Such a policy beats the best LQR policy of the target
over 2.5 s, does not converge, and is unstable just outside Omega. The LQR policies that everything
else here uses are optimal from *every* start. So UDR minimises the mean over starts too: over a
single point it is the LQR policy there, and over Omega all restarts end in one optimum.
`experiments/udr_bound.py` shows both.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy import optimize
from scipy.stats import qmc

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.mechanisms.double_pendulum import linear as pendulum
from adaptsim_jax.space import Space

# ---------------------------------------------------------------- tasks that are solved exactly
#
# A task whose policy is solved exactly: what the bounds, the gradient baseline and the scoring need
# of it.
#
# Learners run in single precision. Every number of the comparison is recomputed here in double
# precision from the means of E that a method visited, so that all methods are scored by the same
# code.


@dataclass(frozen=True)
class ExactProblem:
    """Pure functions on physical parameters `[D]`: `policy(params) -> policy`, `cost(params,
    policy) -> []`.

    `mean_cost` is the cost averaged over starts spread over the state space, which is what makes a
    policy for many `params` well defined (see `udr`). `points(params, policy) -> [K, Q]` are the
    observed positions (rad). `cost_at(u, target) -> []` is the cost in `target [D]` (physical) of
    the policy trained at `u [D]` (unit coordinates), and `slope(u, target)` the same with its
    gradient by `u`, through the Riccati solve and the rollout.
    """

    space: Space
    policy: Callable[[Any], Array]
    cost: Callable[[Any, Any], Array]
    mean_cost: Callable[[Any, Array], Array]
    points: Callable[[Any, Array], Array]
    cost_at: Callable[[Array, Array], Array]
    slope: Callable[[Array, Array], tuple[Array, Array]]


def pendulum_problem(space: Space) -> ExactProblem:
    """The linearized double pendulum with LQR policies (paper, section 5.1); parameters m1, m2, b1,
    b2.

    `mean_cost` averages over starts at pi along each of the four axes of the state.
    """

    def mean_cost(params, gain):
        A, B = pendulum.linearized(params)
        starts = jnp.pi * jnp.eye(4, dtype=A.dtype)
        return jnp.mean(
            jax.vmap(lambda x: pendulum.linear_rollout(A, B, gain, x, (0,)).cost)(starts)
        )

    def cost_at(u, target):
        return pendulum.rollout(target, pendulum.optimal_gain(space.physical(u)).gain).cost

    return ExactProblem(
        space=space,
        policy=lambda params: pendulum.optimal_gain(params).gain,
        cost=lambda params, gain: pendulum.rollout(params, gain).cost,
        mean_cost=mean_cost,
        points=lambda params, gain: pendulum.rollout(params, gain).points[:, :2],
        cost_at=cost_at,
        slope=jax.value_and_grad(cost_at),
    )


def costs(problem: ExactProblem, means: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Costs `[T, ...]` in each of `targets [T, D]` of the policies trained at `means [T, ..., D]`,
    in double precision.
    """
    return _in_targets(problem.cost_at, means, targets)


def discrepancy(problem: ExactProblem, means: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Dynamics discrepancy `[T, ...]` (rad) of section 5.3, for adapted `means [T, ..., D]` and
    `targets [T, D]`.

    The paper says "total variations between trajectories in the target environment and in the
    environment with adapted parameters" and no more. Here: the policy trained at the mean runs in
    both. The absolute differences of both joint angles are summed over the 12 observed points.
    """

    def one(u, target):
        params = problem.space.physical(u)
        policy = problem.policy(params)
        return jnp.sum(jnp.abs(problem.points(target, policy) - problem.points(params, policy)))

    return _in_targets(one, means, targets)


def _in_targets(function: Callable, means: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """`function(u [D], target [D]) -> []` over `means [T, ..., D]` and `targets [T, D]`."""
    with jax.enable_x64(True):
        flat = np.asarray(means, np.float64).reshape(len(targets), -1, np.shape(means)[-1])
        over = jax.jit(jax.vmap(jax.vmap(function, (0, None))))
        out = over(jnp.asarray(flat), jnp.asarray(targets, jnp.float64))
        return np.asarray(out).reshape(np.shape(means)[:-1])


class Udr(NamedTuple):
    """`policy`, and the mean cost over Omega (and over starts) that each restart ended with
    `[R]`.
    """

    policy: np.ndarray
    restarts: np.ndarray


def udr(problem: ExactProblem, *, samples_log2: int = 9, restarts: int = 3, seed: int = 0) -> Udr:
    """Minimise the mean cost over `2^samples_log2` scrambled Sobol points of Omega, in double
    precision.

    BFGS with the exact gradient through the rollout, from the mean of the optimal policies and from
    scattered ones, in units of their spread. Each run goes on until the gradient of the logarithm
    of the cost is nil.
    """
    if samples_log2 < 4 or restarts < 1:
        raise BadInput(
            f"UDR with 2^{samples_log2} samples and {restarts} restarts: give at least 4 and 1"
        )
    with jax.enable_x64(True):
        sobol = qmc.Sobol(problem.space.dim, rng=seed).random_base2(samples_log2)
        params = problem.space.physical(jnp.asarray(sobol))
        optimal = np.asarray(jax.jit(jax.vmap(problem.policy))(params))
        centre, spread = optimal.mean(0), optimal.std(0)

        @jax.jit
        @jax.value_and_grad
        def objective(z):
            policy = centre + spread * z.reshape(centre.shape)
            return jnp.log(jnp.mean(jax.vmap(lambda p: problem.mean_cost(p, policy))(params)))

        rng = np.random.default_rng(seed)
        starts = [np.zeros(centre.size), *rng.normal(size=(restarts - 1, centre.size))]
        how = {"method": "BFGS", "options": {"gtol": 1e-6, "maxiter": 300}}
        ends = [_minimise(objective, start, **how) for start in starts]
    best = min(ends, key=lambda end: end.fun)
    return Udr(centre + spread * best.x.reshape(centre.shape), np.exp([end.fun for end in ends]))


def _minimise(
    value_and_grad: Callable, start: np.ndarray, scale: float = 1.0, **how: Any
) -> optimize.OptimizeResult:
    """By SciPy, in double precision; `scale` divides the value."""

    def both(x):
        value, gradient = value_and_grad(x)
        return float(value) / scale, np.asarray(gradient, np.float64) / scale

    return optimize.minimize(both, start, jac=True, **how)


class Best(NamedTuple):
    """For `T` targets: `mean [T, D]` (unit coordinates) whose policy does best, its `cost [T]`."""

    mean: np.ndarray
    cost: np.ndarray


def best_in_omega(
    problem: ExactProblem, targets: np.ndarray, *, points: int = 9, starts: int = 3
) -> Best:
    """For each of `targets [T, D]` (physical): all of a grid with `points` a side, then refined
    from the best `starts`.

    Double precision. The policies of the grid are solved once for all targets. The refinement is
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
    return Best(*map(np.array, zip(*ends, strict=True)))


def _best_of(
    problem: ExactProblem, target: np.ndarray, costs: np.ndarray, grid: np.ndarray, starts: int
):
    """Mean `[D]` and cost of the best of the grid's `starts` best points after refinement."""
    order = np.argsort(costs)[:starts]
    best = grid[order[0]], float(costs[order[0]])
    slope = jax.jit(problem.slope)
    options = {"ftol": 1e-14, "gtol": 1e-9}
    how = {"method": "L-BFGS-B", "bounds": [(0.0, 1.0)] * grid.shape[1], "options": options}
    for i in order:
        end = _minimise(lambda u: slope(u, target), grid[i], best[1], **how)
        if end.fun * best[1] < best[1]:
            best = end.x, float(end.fun * best[1])
    return best


class RewardMap(NamedTuple):
    """`reward [Y, X]`: the largest normalised reward in the target at `x [X]`, `y [Y]` (physical)
    over the other parameters.

    `low, high [2]`: the range of Omega of both; the map may reach beyond, where no method may go.
    """

    names: tuple[str, str]
    x: np.ndarray
    y: np.ndarray
    reward: np.ndarray
    low: np.ndarray
    high: np.ndarray


def reward_map(
    problem: ExactProblem,
    target: np.ndarray,
    ends: tuple[float, float],
    *,
    names: tuple[str, str] = ("m1", "m2"),
    limits: tuple[tuple[float, float], tuple[float, float]] | None = None,
    points: int = 31,
    others: int = 5,
) -> RewardMap:
    """Evaluate in double precision; `ends` are the costs of UDR and of the best in Omega in
    `target [D]`.

    `limits` are physical; the other parameters take `others` values each within Omega.
    """
    space, (lower, upper) = problem.space, ends
    axes = [space.names.index(name) for name in names]
    boxes = np.array([(space.parameters[a].low, space.parameters[a].high) for a in axes])
    x, y = (np.linspace(low, high, points) for low, high in (boxes if limits is None else limits))
    rest = [i for i in range(space.dim) if i not in axes]
    with jax.enable_x64(True):
        u = np.array(list(product(np.linspace(0, 1, others), repeat=len(rest))))
        middle = jnp.full((len(u), space.dim), 0.5)
        inner = np.asarray(space.physical(middle.at[:, np.array(rest, int)].set(u)))
        params = np.tile(inner, (points, points, 1, 1))
        params[..., axes[0]] = x[None, :, None]
        params[..., axes[1]] = y[:, None, None]

        def cost(p):
            return problem.cost(jnp.asarray(target, jnp.float64), problem.policy(p))

        flat = jax.jit(jax.vmap(cost))(jnp.asarray(params.reshape(-1, space.dim)))
    best = np.asarray(flat).reshape(points, points, -1).min(axis=-1)
    return RewardMap(names, x, y, (lower - best) / (lower - upper), boxes[:, 0], boxes[:, 1])
