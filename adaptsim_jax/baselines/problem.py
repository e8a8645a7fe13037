"""A task whose policy is solved exactly: what the bounds, the gradient baseline and the scoring
need of it.

Learners run in single precision. Every number of the comparison is recomputed here in double
precision from the means of E that a method visited, so that all methods are scored by the same
code.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.mechanisms.double_pendulum import linear as pendulum
from adaptsim_jax.space import Space


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
    policy: Callable[[Any], jax.Array]
    cost: Callable[[Any, Any], jax.Array]
    mean_cost: Callable[[Any, jax.Array], jax.Array]
    points: Callable[[Any, jax.Array], jax.Array]
    cost_at: Callable[[jax.Array, jax.Array], jax.Array]
    slope: Callable[[jax.Array, jax.Array], tuple[jax.Array, jax.Array]]


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
    with jax.enable_x64(True):
        flat = jnp.asarray(
            np.asarray(means, np.float64).reshape(len(targets), -1, problem.space.dim)
        )
        out = jax.jit(jax.vmap(jax.vmap(problem.cost_at, (0, None))))(
            flat, jnp.asarray(targets, jnp.float64)
        )
        return np.asarray(out).reshape(means.shape[:-1])


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

    with jax.enable_x64(True):
        flat = jnp.asarray(
            np.asarray(means, np.float64).reshape(len(targets), -1, problem.space.dim)
        )
        out = jax.jit(jax.vmap(jax.vmap(one, (0, None))))(flat, jnp.asarray(targets, jnp.float64))
        return np.asarray(out).reshape(means.shape[:-1])
