"""Gradient descent on the mean of E through the policy's training and its rollout in the target.

For one target this descends the outer problem of the paper (eq. 1) itself. It needs the derivative
of the target's cost, so the target must be differentiable: a simulated one, or a model of the real
one. It is no method for a robot, but it says what the parameterization allows with as many target
evaluations as the others use. See `docs/howto/differentiable.md`.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

Slope = Callable[[jax.Array, jax.Array], tuple[jax.Array, jax.Array]]
LONGEST_MOVE = 0.25  # of the range, for any parameter in one step


class State(NamedTuple):
    """What the next step needs: `u [D]` in unit coordinates, the gradient there `[D]`, and the
    stride `[]`.
    """

    u: jax.Array
    gradient: jax.Array
    stride: jax.Array


class Info(NamedTuple):
    """What was seen at the mean that a step arrived at: `u [D]`, the cost there `[]`, the projected
    gradient's norm `[]`.
    """

    u: jax.Array
    cost: jax.Array
    stationarity: jax.Array


def init(slope: Slope, u: jax.Array, target: jax.Array) -> tuple[State, Info]:
    """Evaluate the first mean `u [D]` in `target [D]` (physical). `slope(u, target) -> (cost [],
    gradient [D])`.
    """
    cost, gradient = _log_slope(slope, u, target)
    return State(u, gradient, 0.1 / jnp.maximum(jnp.max(jnp.abs(gradient)), 1e-12)), _info(
        u, cost, gradient
    )


def step(slope: Slope, state: State, target: jax.Array) -> tuple[State, Info]:
    """One projected gradient step on the logarithm of the cost, which makes strides free of its
    unit.

    The stride is Barzilai and Borwein's (1988): one evaluation a step, no line search, not
    monotone.
    """
    longest = LONGEST_MOVE / jnp.maximum(jnp.max(jnp.abs(state.gradient)), 1e-12)
    u = jnp.clip(state.u - jnp.minimum(state.stride, longest) * state.gradient, 0.0, 1.0)
    cost, gradient = _log_slope(slope, u, target)
    moved, turned = u - state.u, gradient - state.gradient
    curvature = jnp.sum(moved * turned)
    stride = jnp.where(
        curvature > 1e-12, jnp.sum(moved**2) / jnp.maximum(curvature, 1e-12), 2.0 * state.stride
    )
    return State(u, gradient, stride), _info(u, cost, gradient)


def descend(slope: Slope, u: jax.Array, target: jax.Array, iterations: int = 10) -> Info:
    """`init` and `iterations` steps: `Info` with a leading axis `[iterations + 1]`. Pure; vmap over
    starts and targets.
    """
    state, first = init(slope, u, target)
    _, rest = jax.lax.scan(lambda s, _: step(slope, s, target), state, None, length=iterations)
    return jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, rest)


def _log_slope(slope: Slope, u: jax.Array, target: jax.Array) -> tuple[jax.Array, jax.Array]:
    cost, gradient = slope(u, target)
    gradient = gradient / cost
    return cost, jnp.where(jnp.isfinite(gradient), gradient, 0.0)


def _info(u: jax.Array, cost: jax.Array, gradient: jax.Array) -> Info:
    return Info(u, cost, jnp.linalg.norm(jnp.clip(u - gradient, 0.0, 1.0) - u))
