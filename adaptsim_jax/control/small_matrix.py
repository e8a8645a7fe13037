"""Small matrices with the batch on the trailing axes, so that sums and products vectorise over the
batch.

XLA calls LAPACK once per sample for a batched solve and runs a scalar loop for a batched 4x4
product. Written out over the few rows and columns, with the batch last, both become a handful of
element-wise kernels. Arrays here are `[rows, columns, ...batch]`; `batch_last` lets ordinary code
(`[rows, columns]` under `vmap`) use them.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_batching import custom_vmap

Array = Any


def mm(a: Array, b: Array) -> Array:
    """Product `[n, k, ...] @ [k, m, ...] -> [n, m, ...]`."""
    out = a[:, 0][:, None] * b[0][None]
    for j in range(1, a.shape[1]):
        out = out + a[:, j][:, None] * b[j][None]
    return out


def mv(a: Array, x: Array) -> Array:
    """Product `[n, k, ...] @ [k, ...] -> [n, ...]`."""
    out = a[:, 0] * x[0][None]
    for j in range(1, a.shape[1]):
        out = out + a[:, j] * x[j][None]
    return out


def transpose(a: Array) -> Array:
    """Transpose of the two leading axes."""
    return jnp.swapaxes(a, 0, 1)


def symmetric(a: Array) -> Array:
    """Symmetric part, `[n, n, ...]`."""
    return 0.5 * (a + transpose(a))


def eye_like(a: Array) -> Array:
    """Identity as large as `a: [n, m, ...]` has rows, `[n, n, 1, ...]`: it broadcasts over the
    batch.
    """
    n = a.shape[0]
    return jnp.eye(n, dtype=a.dtype).reshape((n, n) + (1,) * (a.ndim - 2))


def norm(a: Array) -> Array:
    """Frobenius norm over the two leading axes, `[...batch]`, scaled so that it does not overflow
    early.
    """
    biggest = jnp.max(jnp.abs(a), axis=(0, 1))
    safe = jnp.where(biggest > 0, biggest, 1.0)
    return safe * jnp.sqrt(jnp.sum((a / safe[None, None]) ** 2, axis=(0, 1)))


def solve(a: Array, b: Array) -> Array:
    """Solve `a x = b` by Gauss-Jordan elimination with row pivoting: `[n, n, ...], [n, m, ...] ->
    [n, m,
    ...]`.

    A singular `a` gives infinities or NaN, which the caller's result code must catch.
    """
    if a.shape[0] <= _UNROLLED:
        return _eliminate_unrolled(a, b)
    return _eliminate_looped(a, b)


_UNROLLED = (
    4  # written out, elimination runs twice as fast, but compiles in a time that grows as n^3
)


def _eliminate_unrolled(a: Array, b: Array) -> Array:
    n = a.shape[0]
    rows = [jnp.concatenate([a[i], b[i]]) for i in range(n)]
    for k in range(n):
        pivot = rows[k]
        for i in range(k + 1, n):  # bubble the row with the largest entry in this column up
            better = (jnp.abs(rows[i][0]) > jnp.abs(pivot[0]))[None]
            pivot, rows[i] = jnp.where(better, rows[i], pivot), jnp.where(better, pivot, rows[i])
        pivot = pivot[1:] / pivot[0][None]
        rows = [pivot if i == k else row[1:] - row[0][None] * pivot for i, row in enumerate(rows)]
    return jnp.stack(rows)


def _eliminate_looped(a: Array, b: Array) -> Array:
    n, batch = a.shape[0], a.shape[2:]
    row_number = jnp.arange(n).reshape((n,) + (1,) * len(batch))

    def eliminate(k: Array, carry: Any) -> Any:
        m, free, order = carry
        column = lax.dynamic_index_in_dim(m, k, 1, keepdims=False)
        largest = jnp.argmax(jnp.where(free, jnp.abs(column), -1.0), axis=0)
        chosen = row_number == largest[None]
        pivot = jnp.sum(jnp.where(chosen[:, None], m, 0.0), axis=0)
        pivot = pivot / lax.dynamic_index_in_dim(pivot, k, 0)
        m = jnp.where(chosen[:, None], pivot[None], m - column[:, None] * pivot[None])
        return (
            m,
            free & ~chosen,
            lax.dynamic_update_index_in_dim(order, chosen.astype(m.dtype), k, 0),
        )

    carry = jnp.concatenate([a, b], axis=1), jnp.ones((n, *batch), bool), jnp.zeros_like(a)
    m, _, order = lax.fori_loop(0, n, eliminate, carry)
    return mm(order, m[:, n:])  # rows stayed where they were; this puts them in order


def inverse(a: Array) -> Array:
    """Inverse of `[n, n, ...]`, see `solve`."""
    return solve(a, jnp.broadcast_to(eye_like(a), a.shape))


def batch_last(core: Callable[..., Any]) -> Callable[..., Any]:
    """Make `core`, written for arguments with one trailing batch axis, a function of unbatched
    arguments.

    The first argument must be a matrix, `[n, m]`, before batching. Each `vmap` level becomes a
    trailing axis instead of a leading one, and all of them reach `core` as one flat axis. The
    result has no derivative rule: wrap it in `custom_jvp`.
    """

    @custom_vmap
    def mapped(*args: Array) -> Any:
        depth = args[0].ndim - 2
        flat = [x.reshape((*x.shape[: x.ndim - depth], -1)) for x in args]
        batch = args[0].shape[args[0].ndim - depth :]
        return jax.tree.map(lambda y: y.reshape(y.shape[:-1] + batch), core(*flat))

    @mapped.def_vmap
    def rule(axis_size: int, in_batched: list[bool], *args: Array) -> Any:
        moved = []
        for x, batched in zip(args, in_batched, strict=True):
            if batched:
                moved.append(jnp.moveaxis(x, 0, -1))
            else:
                moved.append(jnp.broadcast_to(x[..., None], (*x.shape, axis_size)))
        out = mapped(*moved)
        out = jax.tree.map(lambda y: jnp.moveaxis(y, -1, 0), out)
        return out, jax.tree.map(lambda _: True, out)

    return mapped
