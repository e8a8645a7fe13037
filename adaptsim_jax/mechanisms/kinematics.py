"""Where the frames of a `Tree` are: rotations, origins and screw axes, in the world's axes.

The chain of rotations is written out joint by joint, so that products with what is exactly 0 or 1
in a joint's `rotation` and `place` cost nothing; all that follows works on all joints at once, on
entries `[n, ...batch]`.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from adaptsim_jax.core.trig import sin_cos
from adaptsim_jax.mechanisms.lanes import (
    IDENTITY,
    ZERO,
    Entry,
    Rows,
    Vector,
    add,
    apply,
    mul,
    plus,
    product,
    stacked,
    sub,
    times,
)
from adaptsim_jax.mechanisms.tree import Tree

Array = Any


class Pose(NamedTuple):
    """Of joints' frames: rotation, and the place of the origin (from the place of the first joint
    of the branch).
    """

    rotation: Rows
    origin: Vector

    @property
    def axis(self) -> Vector:
        return tuple(row[2] for row in self.rotation)


def lifted(x: Any, own: int, batch: int, dtype: Any) -> jax.Array:
    """An array of `own` axes, with a batch behind or none, with axes of one put between so that it
    has `batch` behind.
    """
    x = jnp.asarray(x, dtype)
    front, behind = x.shape[:own], x.shape[own:]
    return x.reshape(*front, *(1,) * (batch - (x.ndim - own)), *behind)


def chain(tree: Tree, q: jax.Array) -> list[Pose]:
    """The pose of each joint's frame at `q: [n, ...]`, origins from that of the branch's first
    joint before it slides.
    """
    batch = q.ndim - 1
    sines, cosines = sin_cos(q) if "hinge" in tree.kinds else (q, q)
    place = lifted(tree.place, 2, batch, q.dtype)
    rotation = lifted(tree.rotation, 3, batch, q.dtype)
    poses: list[Pose] = []
    for i, (kind, p) in enumerate(zip(tree.kinds, tree.parent, strict=True)):
        shape = tree.shapes[i]
        still = [
            [rotation[i, r, c] if x is None else x for c, x in enumerate(row)]
            for r, row in enumerate(shape.rotation)
        ]
        origin: Vector = ZERO
        turned: Rows = product(IDENTITY, still)
        if p >= 0:
            turned = product(poses[p].rotation, still)
            offset = [place[i, k] if x is None else x for k, x in enumerate(shape.place)]
            origin = plus(poses[p].origin, apply(poses[p].rotation, offset))
        if kind == "slide":
            poses.append(Pose(turned, plus(origin, times(q[i], [row[2] for row in turned]))))
        else:
            s, c = sines[i], cosines[i]
            rows = [(add(mul(c, x), mul(s, y)), sub(mul(c, y), mul(s, x)), z) for x, y, z in turned]
            poses.append(Pose(tuple(rows), origin))
    return poses


def together(poses: list[Pose], like: jax.Array) -> Pose:
    """All joints' poses as one, with entries `[n, ...]`. An entry that is the same known number for
    all of them stays one.
    """

    def entry(values: list[Entry]) -> Entry:
        first = values[0]
        if isinstance(first, int) and all(isinstance(x, int) and x == first for x in values):
            return first
        return stacked(values, like)

    rotation = tuple(
        tuple(entry([pose.rotation[r][c] for pose in poses]) for c in range(3)) for r in range(3)
    )
    origin = tuple(entry([pose.origin[k] for pose in poses]) for k in range(3))
    return Pose(rotation, origin)
