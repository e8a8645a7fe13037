"""Algebraic Riccati equations of continuous time by structure-preserving doubling.

Chu, Fan & Lin, "A structure-preserving doubling algorithm for continuous-time algebraic Riccati
equations", Linear Algebra Appl. 396 (2005). The solve works on a whole batch at once (see
`small_matrix`) and differentiates by the implicit function theorem, in forward and reverse mode and
more than once.
"""

from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from adaptsim_jax.control.small_matrix import (
    batch_last,
    eye_like,
    inverse,
    mm,
    norm,
    solve,
    symmetric,
    transpose,
)

Array = Any

CONVERGED, INACCURATE, NOT_STABILISING, NOT_FINITE = 0, 1, 2, 3
"""Result codes: the residual is at rounding level; above it, usable with care; no stabilising
solution was found (is (A, B) stabilisable and (A, Q) detectable?); the input or an intermediate
value is NaN or overflowed.
"""


class RiccatiSolution(NamedTuple):
    """`P: [n, n]` symmetric; `residual: []` relative to the equation's terms; `code: []` int32, 0
    is good.
    """

    P: Array
    residual: Array
    code: Array


def solve_care(A: Array, B: Array, Q: Array, R: Array) -> RiccatiSolution:
    """Stabilising `P` of `A'P + PA - P B R^-1 B' P + Q = 0`.

    `A: [n, n]`, `B: [n, m]`, `Q: [n, n]`, `R: [m, m]`; Q and R enter through their symmetric parts.
    Values never raise: read `code`.
    """
    dtype = jnp.result_type(A, B, Q, R, float)
    A, B, Q, R = (jnp.asarray(x, dtype) for x in (A, B, Q, R))
    P, residual, code = _care(A, B, symmetric(Q), symmetric(R))
    return RiccatiSolution(P, residual, code.astype(jnp.int32))


def care_residual(A: Array, B: Array, Q: Array, R: Array, P: Array) -> Array:
    """`A'P + PA - P B R^-1 B' P + Q`, `[n, n]`, all arguments with or without trailing batch
    axes.
    """
    PA, PB = mm(P, A), mm(P, B)
    return PA + transpose(PA) - mm(PB, solve(R, transpose(PB))) + Q


# --- the doubling ---


def _double(A: Array, G: Array, H: Array) -> tuple[Array, Array, Array]:
    """From A, G, H of k steps to those of 2k steps; H converges to P, and A to zero,
    quadratically.
    """
    n = A.shape[0]
    W = eye_like(A) + mm(G, H)
    X = solve(W, jnp.concatenate([A, G], axis=1))
    AX, AY = mm(A, X[:, :n]), mm(A, X[:, n:])
    G2 = symmetric(G + mm(AY, transpose(A)))
    H2 = symmetric(H + mm(mm(transpose(A), H), X[:, :n]))
    return AX, G2, H2


def _most_doublings(dtype: Any) -> int:
    """How slow a mode may be: with more doublings than this, it cannot be told from a marginal one
    by its digits.
    """
    return jnp.finfo(dtype).nmant - 5


def _doubling(A: Array, G: Array, H: Array) -> tuple[Array, Array]:
    """Double until H settles. `[n, n, batch]` each -> `P`, and whether each sample settled,
    `[batch]`.
    """
    # Quadratic convergence: once a change is below sqrt(eps), the next one would be below eps.
    small = 0.1 * jnp.finfo(A.dtype).eps ** 0.5

    def step(carry: Any) -> Any:
        A, G, H, k, settled, dead = carry
        A2, G2, H2 = _double(A, G, H)
        frozen = (settled | dead)[None, None]
        change = norm(H2 - H)
        A = jnp.where(frozen, A, A2)
        G = jnp.where(frozen, G, G2)
        H = jnp.where(frozen, H, H2)
        # A power of the closed loop that is below one proves it stable, also where H does not see
        # it.
        settled = settled | (~dead & (change <= small * norm(H2)) & (norm(A2) < 0.5))
        return A, G, H, k + 1, settled, dead | ~jnp.isfinite(change)

    def going(carry: Any) -> Array:
        k, settled, dead = carry[3:]
        return (k < _most_doublings(H.dtype)) & ~jnp.all(settled | dead)

    no = jnp.zeros(A.shape[2:], bool)
    _, _, H, _, settled, _ = lax.while_loop(going, step, (A, G, H, 0, no, no))
    return H, settled


def _cayley(A: Array, G: Array, Q: Array) -> tuple[Array, Array, Array]:
    """Discrete-time A, G, H whose doubling has the CARE's solution as limit.

    The shifted Hamiltonian `K` has no zero eigenvalue whenever a stabilising solution exists,
    whatever the shift, so inverting it whole is safe where the textbook form, which inverts `A -
    gamma`, is not.
    """
    n = A.shape[0]
    gamma = _shift(A, G, Q)
    shifted = A - gamma * eye_like(A)
    upper = jnp.concatenate([shifted, -G], axis=1)
    lower = jnp.concatenate([-Q, -transpose(shifted)], axis=1)
    T = inverse(jnp.concatenate([upper, lower], axis=0))
    Ad = eye_like(A) + 2 * gamma * T[:n, :n]
    Gd = symmetric(-2 * gamma * T[:n, n:])
    Hd = symmetric(-2 * gamma * T[n:, :n])
    return Ad, Gd, Hd


def _shift(A: Array, G: Array, Q: Array) -> Array:
    """A shift on the scale of the Hamiltonian's eigenvalues, `[1, 1, batch]`."""
    A2 = mm(A, A) + mm(G, Q)
    return jnp.sqrt(norm(A2) / A.shape[0] ** 0.5)[None, None]


def _care_batch(A: Array, B: Array, Q: Array, R: Array) -> tuple[Array, Array, Array]:
    G = symmetric(mm(B, solve(R, transpose(B))))
    # P -> P / scale brings the quadratic and the constant term to the same size.
    scale = jnp.sqrt(norm(Q) / norm(G))[None, None]
    scale = jnp.where(jnp.isfinite(scale) & (scale > 0), scale, 1.0)
    P, settled = _doubling(*_cayley(A, G * scale, Q / scale))
    P = P * scale
    PA, PGP = mm(P, A), mm(P, mm(G, P))
    terms = norm(Q) + 2 * norm(PA) + norm(PGP)
    return _with_code(P, norm(PA + transpose(PA) - PGP + Q) / terms, settled)


def _with_code(P: Array, residual: Array, settled: Array) -> tuple[Array, Array, Array]:
    """Result code by the relative residual; a float here, since it shares a derivative rule with
    P.
    """
    good = 1e4 * jnp.finfo(P.dtype).eps
    finite = jnp.isfinite(norm(P)) & jnp.isfinite(residual)
    code = jnp.where(residual <= good, CONVERGED, INACCURATE)
    code = jnp.where(settled & (residual < 1e-2), code, NOT_STABILISING)
    return P, residual, jnp.where(finite, code, NOT_FINITE).astype(P.dtype)


# --- derivatives ---


@cache
def _batched(core: Any) -> Any:
    return jax.jit(batch_last(core))  # jit for those who call it eagerly


@jax.custom_jvp
def _care(A: Array, B: Array, Q: Array, R: Array) -> Any:
    return _batched(_care_batch)(A, B, Q, R)


@_care.defjvp
def _care_jvp(primals: Any, tangents: Any) -> Any:
    A, B, Q, R = primals
    P, residual, code = _care(A, B, Q, R)
    _, S = jax.jvp(lambda a, b, q, r: care_residual(a, b, q, r, P), primals, tangents)
    closed = A - mm(B, solve(R, mm(transpose(B), P)))
    eye = jnp.eye(A.shape[0], dtype=A.dtype)
    operator = jnp.kron(closed.T, eye) + jnp.kron(eye, closed.T)
    dP = -jnp.linalg.solve(operator, S.reshape(-1)).reshape(S.shape)
    return (P, residual, code), (symmetric(dP), jnp.zeros_like(residual), jnp.zeros_like(code))


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
