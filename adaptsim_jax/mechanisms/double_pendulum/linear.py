"""Double pendulum linearized about upright (paper, section 5.1), propagated exactly.

Unit links with point masses at their ends; `params: [4]` are `m1, m2` (kg) and the viscous joint
dampings `b1, b2` (N m s/rad). The state is `(q1, q2, v1, v2)` (rad, rad/s) with q2 relative to link
1 and zero upright. Between samples the closed loop is a matrix power, so a cost over 1000 samples
takes a dozen products instead of 1000 steps.
"""

from collections.abc import Sequence
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from adaptsim_jax.control.riccati import LqrGain, lqr_gain
from adaptsim_jax.control.small_matrix import batch_last, eye_like, mm, mv, norm, transpose
from adaptsim_jax.core.constants import GRAVITY

Array = Any

HORIZON = 2.5  # s, the paper's
SAMPLES = 1000  # equispaced over the horizon, both ends included, as in the paper
START = (-np.pi, 0.0, 0.0, 0.0)  # hanging straight down
SNAPSHOTS = tuple(range(81, 973, 81))  # 12 points spread over the horizon: the standard observation
LATE_SNAPSHOTS = tuple(
    int(i) for i in np.round(np.linspace(0.8 * (SAMPLES - 1), SAMPLES - 1, 12))
)  # last 0.5 s
COST_CEILING = 1e20  # what an overflowing cost is reported as

OK, UNSTABLE, OVERFLOW = range(3)
"""Codes of `rollout`. UNSTABLE: the closed loop is; its cost over the horizon is finite and exact.
OVERFLOW: within the horizon, or input that is not finite; the cost is a ceiling.
"""


class LinearRollout(NamedTuple):
    """`cost: []` summed over the samples, `points: [K, 4]` states at wanted samples, `code: []`
    int32.
    """

    cost: Array
    points: Array
    code: Array


def linearized(params: Array, gravity: float = GRAVITY) -> tuple[Array, Array]:
    """`params: [4] -> A [4, 4], B [4, 2]` of `dx/dt = A x + B tau`, `tau: [2]` N m at the
    joints.
    """
    m1, m2, b1, b2 = params
    ratio, zero, one = m2 / m1, jnp.zeros_like(m1), jnp.ones_like(m1)
    # Inverse of the upright mass matrix [[m1 + 4 m2, 2 m2], [2 m2, m2]], written out.
    i11, i12, i22 = 1 / m1, -2 / m1, 1 / m2 + 4 / m1
    speeds = [[zero, zero, one, zero], [zero, zero, zero, one]]
    first_link = [gravity * one, -gravity * ratio, -b1 * i11, -b2 * i12]
    second_link = [-gravity * one, gravity * (1 + 2 * ratio), -b1 * i12, -b2 * i22]
    A = [*speeds, first_link, second_link]
    B = [[zero, zero], [zero, zero], [i11, i12], [i12, i22]]
    return jnp.stack([jnp.stack(row) for row in A]), jnp.stack([jnp.stack(row) for row in B])


def optimal_gain(params: Array) -> LqrGain:
    """LQR `gain: [2, 4]` for `params: [4]` with unit weights, `u = -gain x`, and its Riccati
    code.
    """
    A, B = linearized(params)
    return lqr_gain(A, B, jnp.eye(4, dtype=A.dtype), jnp.eye(2, dtype=A.dtype))


def rollout(params: Array, gain: Array, indices: Sequence[int] = SNAPSHOTS) -> LinearRollout:
    """Closed loop `u = -gain x` from hanging: `params: [4]`, `gain: [2, 4]` -> cost, points, code.

    The cost is the plain sum of `x'x + u'u` over the 1000 samples of [0, 2.5] s; `indices` (static)
    are the samples wanted as points. Nothing returned is NaN or infinite: an unstable loop says so
    in its code.
    """
    A, B = linearized(params)
    return linear_rollout(A, B, gain, jnp.asarray(START, A.dtype), tuple(indices))


def linear_rollout(
    A: Array, B: Array, gain: Array, x0: Array, indices: tuple[int, ...]
) -> LinearRollout:
    """`rollout` for any `A: [n, n]`, `B: [n, m]`, `gain: [m, n]` and start `x0: [n]`."""
    cost, points, code = _propagate(tuple(indices), A - mm(B, gain), gain, x0)
    return LinearRollout(cost, points, code.astype(jnp.int32))


def transition(A: Array, dt: Any) -> Array:
    """Matrix exponential of `A dt`, `[n, n, ...]`, by a scaled Taylor series and squaring."""
    return eye_like(A) + _expm1(A * dt)


# --- exact sums ---

_SQUARINGS = 6  # reaches |A dt| of 2^6 / 2; what is larger than that is reported as overflow
_TERMS = 8  # of the exponential's series: the rest is below single precision


def _expm1(X: Array) -> Array:
    """`exp(X) - I`. Without the identity, slow modes keep their digits in single precision. `[n, n,
    ...]`.
    """
    size = norm(X)[None, None]
    halvings = jnp.clip(jnp.ceil(jnp.log2(jnp.maximum(size, 1e-30)) + 1), 0, _SQUARINGS)
    X = X * 2.0**-halvings

    def horner(i: Array, E: Array) -> Array:
        return (X + mm(X, E)) / (_TERMS - i)

    def square(k: Array, E: Array) -> Array:
        return jnp.where(k < halvings, 2 * E + mm(E, E), E)

    E = lax.fori_loop(1, _TERMS, horner, X / _TERMS)
    return lax.fori_loop(0, _SQUARINGS, square, E)


def _powers_and_sums(E: Array, C: Array, count: int) -> tuple[Array, Array]:
    """Compute, with `F = I + E`, for every k with `2^k <= count`: `F^(2^k) - I`, and `sum_{i < 2^k}
    F'^i C F^i`.
    """

    def double(carry: tuple[Array, Array], _: None) -> Any:
        E, S = carry
        half = S + mm(S, E)
        return (2 * E + mm(E, E), S + half + mm(transpose(E), half)), carry

    return lax.scan(double, (E, C), None, length=count.bit_length())[1]


def _sum_along(powers: Array, sums: Array, x0: Array, count: int) -> Array:
    """`sum_{i < count} x_i' C x_i` over the states from `x0: [n, ...]`, by the binary digits of
    `count`.
    """
    digits = np.array([k for k in range(count.bit_length()) if count >> k & 1])

    def add(x: Array, ES: tuple[Array, Array]) -> tuple[Array, Array]:
        E, S = ES
        return x + mv(E, x), jnp.sum(x * mv(S, x), axis=0)

    return jnp.sum(lax.scan(add, x0, (powers[digits], sums[digits]))[1], axis=0)


def _power(powers: Array, count: int) -> Array:
    """`F^count - I` from the binary powers."""
    digits = [k for k in range(count.bit_length()) if count >> k & 1]
    out = powers[digits[0]]
    for k in digits[1:]:
        out = out + powers[k] + mm(out, powers[k])
    return out


def _points(powers: Array, x0: Array, indices: tuple[int, ...]) -> Array:
    """States at increasing sample `indices`, `[K, n, ...]`, hopping by matrices that equal gaps
    share.
    """
    gaps = np.diff(indices, prepend=0)
    sizes = sorted(set(gaps.tolist()))
    hops = jnp.stack(
        [_power(powers, size) if size else jnp.zeros_like(powers[0]) for size in sizes]
    )

    def hop(x: Array, which: Array) -> tuple[Array, Array]:
        x = x + mv(hops[which], x)
        return x, x

    return lax.scan(hop, x0, np.searchsorted(sizes, gaps))[1]


def _propagate_plain(
    indices: tuple[int, ...], closed: Array, gain: Array, x0: Array
) -> tuple[Array, Array, Array]:
    """Cost, points and code for `closed: [n, n, ...]`, `gain: [m, n, ...]`, `x0: [n, ...]`."""
    E = _expm1(closed * (HORIZON / (SAMPLES - 1)))
    C = eye_like(closed) + mm(transpose(gain), gain)
    powers, sums = _powers_and_sums(E, C, SAMPLES)
    cost = _sum_along(powers, sums, x0, SAMPLES)
    points = _points(powers, x0, indices)
    code = _stability(eye_like(closed) + powers[-1])
    fits = jnp.isfinite(cost) & (cost < COST_CEILING) & jnp.all(jnp.isfinite(points), axis=(0, 1))
    fits = fits & (norm(closed) * (HORIZON / (SAMPLES - 1)) < 2.0 ** (_SQUARINGS - 1))
    cost = jnp.where(fits, cost, COST_CEILING)
    points = jnp.where(fits[None, None], points, 0.0)
    return cost, points, jnp.where(fits, code, OVERFLOW).astype(cost.dtype)


def _stability(F: Array) -> Array:
    """UNSTABLE where a far power of `F` has grown beyond `F`'s own size."""
    power = lax.fori_loop(0, 4, lambda _, X: mm(X, X), F)
    return jnp.where(norm(power) < 1.0, OK, UNSTABLE)


@cache
def _batched(indices: tuple[int, ...]) -> Any:
    return jax.jit(
        batch_last(partial(_propagate_plain, indices))
    )  # jit for those who call it eagerly


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _propagate(indices: tuple[int, ...], closed: Array, gain: Array, x0: Array) -> Any:
    return _batched(indices)(closed, gain, x0)


@_propagate.defjvp
def _propagate_jvp(indices: tuple[int, ...], primals: Any, tangents: Any) -> Any:
    # The batched form has no derivative rule of its own; the plain one is the same computation.
    return jax.jvp(partial(_propagate_plain, indices), primals, tangents)
