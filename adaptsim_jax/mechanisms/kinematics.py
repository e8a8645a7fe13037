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
    stack,
    sub,
    times,
)
from adaptsim_jax.mechanisms.tree import Tree

Array = Any


class Pose(NamedTuple):
    """Rotation of a joint's frame, and its origin (from that of the first joint of the
    branch, m).
    """

    rotation: Rows
    origin: Vector

    @property
    def axis(self) -> Vector:
        return tuple(row[2] for row in self.rotation)


def with_batch_axes(x: Any, n_own: int, n_batch: int, dtype: Any) -> jax.Array:
    """An array of `n_own` axes, with a batch behind or none, with axes of one put between so that
    it has `n_batch` behind.
    """
    x = jnp.asarray(x, dtype)
    front, batch = x.shape[:n_own], x.shape[n_own:]
    return x.reshape(*front, *(1,) * (n_batch - (x.ndim - n_own)), *batch)


def chain(tree: Tree, q: jax.Array) -> list[Pose]:
    """The pose of each joint's frame at `q: [n, ...]`, origins from that of the branch's first
    joint before it slides.
    """
    batch = q.ndim - 1
    sines, cosines = sin_cos(q) if "hinge" in tree.kinds else (q, q)
    place = with_batch_axes(tree.place, 2, batch, q.dtype)
    rotation = with_batch_axes(tree.rotation, 3, batch, q.dtype)
    poses: list[Pose] = []
    for i, (kind, p) in enumerate(zip(tree.kinds, tree.parent, strict=True)):
        static = tree.shapes[i]
        rest_rotation = [
            [rotation[i, r, c] if x is None else x for c, x in enumerate(row)]
            for r, row in enumerate(static.rotation)
        ]
        origin: Vector = ZERO
        frame_rotation: Rows = product(IDENTITY, rest_rotation)
        if p >= 0:
            frame_rotation = product(poses[p].rotation, rest_rotation)
            offset = [place[i, k] if x is None else x for k, x in enumerate(static.place)]
            origin = plus(poses[p].origin, apply(poses[p].rotation, offset))
        if kind == "slide":
            poses.append(
                Pose(frame_rotation, plus(origin, times(q[i], [row[2] for row in frame_rotation])))
            )
        else:
            s, c = sines[i], cosines[i]
            rows = [
                (add(mul(c, x), mul(s, y)), sub(mul(c, y), mul(s, x)), z)
                for x, y, z in frame_rotation
            ]
            poses.append(Pose(tuple(rows), origin))
    return poses


def stack_poses(poses: list[Pose], like: jax.Array) -> Pose:
    """Stack all joints' poses to one, with entries `[n, ...]`. An entry that is the same static
    number for all of them stays one.
    """

    def entry(values: list[Entry]) -> Entry:
        first = values[0]
        if isinstance(first, int) and all(isinstance(x, int) and x == first for x in values):
            return first
        return stack(values, like)

    rotation = tuple(
        tuple(entry([pose.rotation[r][c] for pose in poses]) for c in range(3)) for r in range(3)
    )
    origin = tuple(entry([pose.origin[k] for pose in poses]) for k in range(3))
    return Pose(rotation, origin)
