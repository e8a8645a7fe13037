"""Short vectors whose entries are lanes, and motions, wrenches and inertias made of them.

An entry is an array (a scalar, or lanes on any trailing axes), or one of the Python integers -1, 0
and 1. These stand for what the geometry of a mechanism makes exactly so. Sums and products with
them cost nothing: a planar arm gets planar formulas without a word that it is planar. Vectors are
sequences of 3 entries, matrices of 3 rows.

A motion is (angular, linear of the point), a wrench (moment about the point, force). Both are pairs
of vectors in the world's axes. Products are those of Featherstone, "Rigid Body Dynamics
Algorithms", 2008, chapter 2.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

Entry = Any  # an array, or the integer -1, 0 or 1
Vector = Sequence[Entry]
Rows = Sequence[Vector]

ZERO: Vector = (0, 0, 0)
IDENTITY: Rows = ((1, 0, 0), (0, 1, 0), (0, 0, 1))


def is_static(x: Entry) -> bool:
    """Whether the entry is one of the integers."""
    return isinstance(x, int)


def mul(a: Entry, b: Entry) -> Entry:
    if is_static(b):
        a, b = b, a
    if is_static(a):
        if a == 0:
            return 0
        if a == 1:
            return b
        return neg(b)
    return a * b


def neg(a: Entry) -> Entry:
    return -a


def add(a: Entry, b: Entry) -> Entry:
    if is_static(b):
        a, b = b, a
    if is_static(a):
        if a == 0:
            return b
        if is_static(b):
            total = a + b
            if -1 <= total <= 1:
                return total
            return float(total)
    return a + b


def sub(a: Entry, b: Entry) -> Entry:
    if is_static(b) and b == 0:
        return a
    if is_static(a) and a == 0:
        return neg(b)
    if is_static(b):
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
    planes = ((1, 2), (2, 0), (0, 1))
    return tuple(sub(mul(a[i], b[j]), mul(a[j], b[i])) for i, j in planes)


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


def stack(entries: Sequence[Entry], like: jax.Array) -> jax.Array:
    """`[k, ...]` of `k` entries, of the common shape of them and of `like`."""
    shape = jnp.broadcast_shapes(like.shape, *(jnp.shape(x) for x in entries))
    return jnp.stack([jnp.broadcast_to(jnp.asarray(x, like.dtype), shape) for x in entries])


Pair = tuple[Vector, Vector]


class InertialBody(NamedTuple):
    """Mass, first moment and moments of inertia about the point."""

    mass: Entry
    moment: Vector
    inertia: Rows


def plus_pair(a: Pair, b: Pair) -> Pair:
    return plus(a[0], b[0]), plus(a[1], b[1])


def times_pair(s: Entry, a: Pair) -> Pair:
    return times(s, a[0]), times(s, a[1])


def dot_pair(a: Pair, b: Pair) -> Entry:
    """Power of a wrench on a motion."""
    return add(dot(a[0], b[0]), dot(a[1], b[1]))


def cross_motion(m: Pair, x: Pair) -> Pair:
    """Rate of the motion `x` that moves along with `m`."""
    angular = cross(m[0], x[0])
    return angular, plus(cross(m[0], x[1]), cross(m[1], x[0]))


def cross_wrench(m: Pair, x: Pair) -> Pair:
    """Rate of the wrench `x` that moves along with `m`."""
    moment = plus(cross(m[0], x[0]), cross(m[1], x[1]))
    return moment, cross(m[0], x[1])


def momentum(body: InertialBody, m: Pair) -> Pair:
    """Inertia times motion."""
    angular = plus(apply(body.inertia, m[0]), cross(body.moment, m[1]))
    return angular, plus(times(body.mass, m[1]), cross(m[0], body.moment))


def rotate_body(rotation: Rows, mass: Entry, moment: Vector, inertia: Rows) -> InertialBody:
    """Rotate a body given in the axes of a frame of this rotation into the world's."""
    half = product(rotation, inertia)
    six = [dot(half[r], rotation[c]) for r in range(3) for c in range(r, 3)]
    return InertialBody(mass, apply(rotation, moment), symmetric(*six))


def move_reference(body: InertialBody, d: Vector) -> InertialBody:
    """Express a body about another point, from which the old one is `d` away (m)."""
    h, inertia = body.moment, body.inertia
    md = plus(h, times(body.mass, d))  # h d' + d h' + m d d' = h d' + d md'
    diagonal = add(dot(h, d), dot(md, d))

    def entry(r, c):
        return sub(inertia[r][c], add(mul(h[r], d[c]), mul(d[r], md[c])))

    six = [
        add(entry(r, c), diagonal) if r == c else entry(r, c) for r in range(3) for c in range(r, 3)
    ]
    return InertialBody(body.mass, md, symmetric(*six))


def swirl(body: InertialBody, m: Pair) -> tuple[Rows, Vector]:
    """`K [3, 3]` and the linear momentum `p`: for any motion (a, b), V x* I (a, b) + (a, b) x* I V
    + I ((a, b) x V) is the wrench (K a, 2 a x p), where V is `m` (the b falls out by Jacobi's
    identity).
    """
    omega, u = m
    push = plus(times(body.mass, u), cross(omega, body.moment))
    spin: list[list[Entry]] = [[0] * 3 for _ in range(3)]
    columns = [[row[c] for row in body.inertia] for c in range(3)]
    around = [cross(omega, column) for column in columns]  # [omega] J, by columns
    along = dot(body.moment, u)
    x, y, z = apply(body.inertia, omega)
    skew = ((0, sub(0, z), y), (z, 0, sub(0, x)), (sub(0, y), x, 0))
    for r in range(3):
        for c in range(3):
            both = add(around[c][r], around[r][c])
            both = sub(sub(both, skew[r][c]), mul(2.0, mul(u[r], body.moment[c])))
            spin[r][c] = add(both, mul(2.0, along)) if r == c else both
    return tuple(tuple(row) for row in spin), push
