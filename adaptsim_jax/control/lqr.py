"""Infinite-horizon linear quadratic regulators on top of the Riccati solver."""

from typing import Any, NamedTuple

from adaptsim_jax.control.riccati import solve_care
from adaptsim_jax.control.small_matrix import mm, solve, transpose

Array = Any


class LqrGain(NamedTuple):
    """`gain: [m, n]` of the law `u = -gain x`, and the Riccati result `code: []` (0 is good)."""

    gain: Array
    code: Array


def lqr_gain(A: Array, B: Array, Q: Array, R: Array) -> LqrGain:
    """Gain that minimises the integral of `x'Qx + u'Ru` under `dx/dt = A x + B u`. As in
    `solve_care`.
    """
    P, _, code = solve_care(A, B, Q, R)
    return LqrGain(solve(R, mm(transpose(B), P)), code)
