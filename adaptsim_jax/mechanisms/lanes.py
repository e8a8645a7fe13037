"""Arithmetic on short vectors whose entries are lanes, with zeros and ones that are known before
tracing.

An entry is either an array (a scalar, or lanes on any trailing axes) or one of the Python integers
-1, 0 and 1, which stand for what the geometry of a mechanism makes exactly so. Sums and products
with those integers cost nothing: a planar arm gets planar formulas without being told that it is
planar. Vectors are sequences of 3 entries, matrices of 3 rows.
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

Entry = Any  # an array, or the integer -1, 0 or 1
Vector = Sequence[Entry]
Rows = Sequence[Vector]

ZERO: Vector = (0, 0, 0)
IDENTITY: Rows = ((1, 0, 0), (0, 1, 0), (0, 0, 1))


def known(x: Entry) -> bool:
    """Whether the entry is one of the integers."""
    return isinstance(x, int)


def mul(a: Entry, b: Entry) -> Entry:
    if known(b):
        a, b = b, a
    if known(a):
        if a == 0:
            return 0
        if a == 1:
            return b
        return neg(b)
    return a * b


def neg(a: Entry) -> Entry:
    return -a


def add(a: Entry, b: Entry) -> Entry:
    if known(b):
        a, b = b, a
    if known(a):
        if a == 0:
            return b
        if known(b):
            total = a + b
            if -1 <= total <= 1:
                return total
            return float(total)
    return a + b


def sub(a: Entry, b: Entry) -> Entry:
    if known(b) and b == 0:
        return a
    if known(a) and a == 0:
        return neg(b)
    if known(b):
        return add(a, neg(b))
    return a - b


def total(entries: Sequence[Entry]) -> Entry:
    out: Entry = 0
    for entry in entries:
        out = add(out, entry)
    return out


def dot(a: Vector, b: Vector) -> Entry:
    return total([mul(x, y) for x, y in zip(a, b, strict=True)])


def plus(a: Vector, b: Vector) -> Vector:
    return tuple(add(x, y) for x, y in zip(a, b, strict=True))


def minus(a: Vector, b: Vector) -> Vector:
    return tuple(sub(x, y) for x, y in zip(a, b, strict=True))


def times(s: Entry, a: Vector) -> Vector:
    return tuple(mul(s, x) for x in a)


def cross(a: Vector, b: Vector) -> Vector:
    return tuple(sub(mul(a[i], b[j]), mul(a[j], b[i])) for i, j in ((1, 2), (2, 0), (0, 1)))


def apply(m: Rows, a: Vector) -> Vector:
    """`m @ a`."""
    return tuple(dot(row, a) for row in m)


def apply_transposed(m: Rows, a: Vector) -> Vector:
    """`m.T @ a`."""
    return tuple(dot([row[k] for row in m], a) for k in range(3))


def product(a: Rows, b: Rows) -> Rows:
    """`a @ b`."""
    columns = list(zip(*b, strict=True))
    return tuple(tuple(dot(row, column) for column in columns) for row in a)


def symmetric(xx: Entry, xy: Entry, xz: Entry, yy: Entry, yz: Entry, zz: Entry) -> Rows:
    """The symmetric matrix of these six entries."""
    return (xx, xy, xz), (xy, yy, yz), (xz, yz, zz)


def stacked(entries: Sequence[Entry], like: jax.Array) -> jax.Array:
    """`[k, ...]` of `k` entries, of the common shape of them and of `like`."""
    shape = jnp.broadcast_shapes(like.shape, *(jnp.shape(x) for x in entries))
    return jnp.stack([jnp.broadcast_to(jnp.asarray(x, like.dtype), shape) for x in entries])
