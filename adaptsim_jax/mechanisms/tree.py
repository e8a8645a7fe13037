"""A tree of hinge and slide joints on a fixed base, as arrays.

**Frames.** Every joint carries one moving body. The frame of joint i sits on that body, its origin on the joint's axis and its
z axis *along* the joint's axis; `place` and `rotation` say where it is in the frame of the body before it (of the world, where
`parent` is -1) at q = 0. So a hinge turns the frame about its own z, and a slide moves it along it. Bodies without joints are
part of the body that they are welded to; a body with several joints is the last of a series of bodies of which the others
weigh nothing.

**Inertial parameters** of a body, about the origin and in the axes of its joint's frame: `m, m cx, m cy, m cz` (kg, kg m), then
`Ixx, Ixy, Ixz, Iyy, Iyz, Izz` (kg m^2), the moments about the *origin* and `Ixy = -sum m x y`. Dynamics are linear in them.

Arrays are numpy in double precision until a function of `dynamics.py` casts them to the type of `q`; they may carry lanes on
trailing axes, as if each mechanism of a batch had its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import jax
import numpy as np

Array = Any

INERTIAL = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
MOST_JOINTS = 12
EXACT = 1e-14  # rotations by quarter turns come out of a quaternion this close to -1, 0 and 1


@dataclass(frozen=True)
class Shape:
    """What is exactly -1, 0 or 1 in a joint's `place` and `rotation` (None where nothing is), and whether its body weighs
    nothing. Known before tracing, so that the formulas leave it out."""

    place: tuple[int | None, ...]  # 3
    rotation: tuple[tuple[int | None, ...], ...]  # 3 rows
    massless: bool


@dataclass(frozen=True)
class Tree:
    """See the module's text. `n` joints; joint i moves body i. SI units; angles in rad.

    place [n, 3] m, rotation [n, 3, 3], gravity [3] m/s^2 in the world; inertial [n, 10]; damping N m s/rad (N s/m for a slide),
    armature kg m^2 (kg), frictionloss N m (N), stiffness N m/rad (N/m) about springref rad (m), each [n]. `damping_poly` and
    `stiffness_poly` [n, 2] are MuJoCo's higher coefficients: the force is -(d + d1 |v| + d2 v^2) v, and so with q - springref.
    range [n, 2] rad or m, of use where `limited`. linear: its equations of motion are those about rest at zero (`equations.py`).
    """

    joint_names: tuple[str, ...]
    kinds: tuple[str, ...]  # hinge or slide
    parent: tuple[int, ...]
    body_names: tuple[str, ...]
    limited: tuple[bool, ...]
    shapes: tuple[Shape, ...]
    place: Array
    rotation: Array
    gravity: Array
    inertial: Array
    damping: Array
    armature: Array
    frictionloss: Array
    stiffness: Array
    springref: Array
    damping_poly: Array
    stiffness_poly: Array
    range: Array
    linear: bool = False

    @property
    def n(self) -> int:
        return len(self.kinds)

    @property
    def axis(self) -> np.ndarray:
        """[n, 3], in the joint's frame: always its z."""
        return np.tile([0.0, 0.0, 1.0], (self.n, 1))

    @property
    def massless(self) -> tuple[bool, ...]:
        """Bodies that only join two joints of one body: they weigh nothing, whatever `inertial` a function is given."""
        return tuple(shape.massless for shape in self.shapes)

    def unit(self, joint: int) -> str:
        """Of the joint's coordinate."""
        return "rad" if self.kinds[joint] == "hinge" else "m"

    def force_unit(self, joint: int) -> str:
        return "N m" if self.kinds[joint] == "hinge" else "N"


_OF_EACH = ("joint_names", "kinds", "parent", "body_names", "limited", "shapes")
_META = (*_OF_EACH, "linear")
_DATA = tuple(f.name for f in fields(Tree) if f.name not in _META)
_OF_JOINTS = tuple(name for name in _DATA if name != "gravity")
jax.tree_util.register_dataclass(Tree, data_fields=_DATA, meta_fields=_META)


def make_tree(
    kinds: Sequence[str],
    parent: Sequence[int],
    place: Any,
    rotation: Any,
    inertial: Any,
    *,
    gravity: Any = (0.0, 0.0, -9.81),
    joint_names: Sequence[str] = (),
    body_names: Sequence[str] = (),
    limited: Sequence[bool] = (),
    **values: Any,
) -> Tree:
    """A tree from arrays as `Tree` has them; what is not given is zero, and `range` without limits.

    Raises ValueError where sizes do not agree or a joint comes before its parent.
    """
    n = len(kinds)
    if any(k not in ("hinge", "slide") for k in kinds):
        raise ValueError(f"kinds {tuple(kinds)} must be 'hinge' or 'slide'")
    if len(parent) != n or any(not -1 <= p < i for i, p in enumerate(parent)):
        raise ValueError(f"parent {tuple(parent)} must name an earlier joint, or -1, for each of {n} joints")
    sizes = {"damping_poly": (n, 2), "stiffness_poly": (n, 2), "range": (n, 2)}
    arrays: dict[str, Any] = {"place": place, "rotation": rotation, "inertial": inertial}
    shapes = {"place": (n, 3), "rotation": (n, 3, 3), "inertial": (n, 10)}
    for name in _OF_JOINTS:
        if name not in arrays:
            arrays[name] = values.pop(name, np.zeros(sizes.get(name, (n,))))
            shapes[name] = sizes.get(name, (n,))
        arrays[name] = np.asarray(arrays[name], float)
        if arrays[name].shape != shapes[name]:
            raise ValueError(f"{name} has shape {arrays[name].shape}, but {n} joints need {shapes[name]}")
    if values:
        raise ValueError(f"a tree has no {', '.join(values)}")
    snapped = {name: _snapped(arrays[name]) for name in ("place", "rotation")}
    tree = Tree(
        tuple(joint_names) or tuple(f"joint{i + 1}" for i in range(n)), tuple(kinds), tuple(int(p) for p in parent),
        tuple(body_names) or tuple(f"body{i + 1}" for i in range(n)), tuple(map(bool, limited)) or (False,) * n, (),
        gravity=np.asarray(gravity, float), **(arrays | snapped),
    )  # fmt: skip
    return reshaped(tree)


def reshaped(tree: Tree) -> Tree:
    """The tree with `shapes` found anew, after `place`, `rotation` or `inertial` were replaced by other numbers."""
    place, rotation, inertial = (np.asarray(x, float) for x in (tree.place, tree.rotation, tree.inertial))
    shapes = tuple(
        Shape(
            tuple(0 if x == 0 else None for x in place[i]),
            tuple(tuple(int(x) if x in (-1.0, 0.0, 1.0) else None for x in row) for row in rotation[i]),
            bool(np.all(inertial[i] == 0)),
        )
        for i in range(tree.n)
    )
    return replace(tree, shapes=shapes)


def _snapped(x: np.ndarray) -> np.ndarray:
    whole = np.round(x)
    return np.where((np.abs(x - whole) < EXACT) & (np.abs(whole) <= 1), whole, x)


def ancestors(tree: Tree, joint: int) -> tuple[int, ...]:
    """Of a joint, the nearest first, without itself."""
    out = []
    while (joint := tree.parent[joint]) >= 0:
        out.append(joint)
    return tuple(out)


def subtrees(tree: Tree) -> list[tuple[int, ...]]:
    """Groups of joints that share no moving body, hence no inertia: each may be simulated and fitted by itself."""
    root: list[int] = []
    for i, p in enumerate(tree.parent):
        root.append(i if p < 0 else root[p])
    return [tuple(i for i in range(tree.n) if root[i] == r) for r in sorted(set(root))]


def take(tree: Tree, indices: Sequence[int]) -> Tree:
    """The joints `indices`, in that order, as a tree of their own. Raises ValueError where a parent would be missing."""
    new = {old: i for i, old in enumerate(indices)}
    if len(new) != len(indices):
        raise ValueError(f"indices {tuple(indices)} name a joint twice")
    missing = sorted({tree.parent[i] for i in indices} - set(new) - {-1})
    if missing:
        raise ValueError(
            f"joints {tuple(indices)} hang on {[tree.joint_names[i] for i in missing]}; take those as well"
        )
    if any(new.get(tree.parent[i], -1) > new[i] for i in indices):
        raise ValueError(f"indices {tuple(indices)} must name a joint after its parent")
    at = np.asarray(indices, int)
    meta = {name: tuple(getattr(tree, name)[i] for i in indices) for name in _OF_EACH}
    meta["parent"] = tuple(new.get(p, -1) for p in meta["parent"])
    return replace(tree, **meta, **{name: getattr(tree, name)[at] for name in _OF_JOINTS})
