"""A tree of hinge and slide joints on a fixed base, as arrays.

**Frames.** Every joint carries one moving body. The frame of joint i sits on that body, its origin
on the joint's axis and its z axis *along* the joint's axis; `place` and `rotation` say where it is
in the frame of the body before it (of the world, where `parent` is -1) at q = 0. So a hinge turns
the frame about its own z, and a slide moves it along it. Bodies without joints are part of the body
that they are welded to. A body with several joints is the last of a series of bodies of which the
others weigh nothing.

**Inertial parameters** of a body, about the origin and in the axes of its joint's frame: `m, m cx,
m cy, m cz` (kg, kg m), then `Ixx, Ixy, Ixz, Iyy, Iyz, Izz` (kg m^2), the moments about the *origin*
and `Ixy = -sum m x y`. Dynamics are linear in them.

Arrays are numpy in double precision until a function of `dynamics.py` casts them to the type of
`q`. They may carry lanes on trailing axes, as if each mechanism of a batch had its own.

**Followers.** A joint that follows another (a mimic, an equality of two joints) is no coordinate of
its own: `whole` then is the tree of all joints, and says which coordinate each of them goes with.
The fields of the tree itself are those of its coordinates, each at the joint that it is named
after. What followers have of friction, inertia of rotors and springs is added to theirs.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import jax
import numpy as np

Array = Any

MOST_JOINTS = 64  # a humanoid with hands; programs grow with the joints
EXACT = 1e-14  # rotations by quarter turns come out of a quaternion this close to -1, 0 and 1


@dataclass(frozen=True)
class Shape:
    """What is exactly -1, 0 or 1 in a joint's `place` and `rotation` (None where nothing is), and
    whether its body weighs nothing. Known before tracing, so that the formulas leave it out.
    """

    place: tuple[int | None, ...]  # 3
    rotation: tuple[tuple[int | None, ...], ...]  # 3 rows
    massless: bool


@dataclass(frozen=True)
class Whole:
    """All joints of a tree of which some follow others.

    Joint k is at `offset[k] + factor[k] * q[leader[k]]`.

    - `tree`: Of all joints, each a coordinate.
    - `leader [m]`: The coordinate that each goes with (static).
    - `own [n]`: The joint that each coordinate is (static).
    - `factor [m]`: In units of the joint over those of its leader.
    - `offset [m]`: Rad or m.
    """

    tree: "Tree"
    leader: tuple[int, ...]
    own: tuple[int, ...]
    factor: Array
    offset: Array


jax.tree_util.register_dataclass(
    Whole, data_fields=["tree", "factor", "offset"], meta_fields=["leader", "own"]
)


@dataclass(frozen=True)
class Tree:
    """See the module's text. `n` joints; joint i moves body i. SI units; angles in rad.

    - `place [n, 3]` m, `rotation [n, 3, 3]`, `inertial [n, 10]`. `gravity [3]` m/s^2 in the world.
    - `damping [n]`: N m s/rad (N s/m for a slide).
    - `armature [n]`: kg m^2 (kg). `frictionloss [n]`: N m (N).
    - `stiffness [n]`: N m/rad (N/m) about `springref` rad (m).
    - `damping_poly`, `stiffness_poly [n, 2]`: MuJoCo's higher coefficients. The force is
      -(d + d1 |v| + d2 v^2) v, and so with q - springref.
    - `range [n, 2]`: Rad or m, of use where `limited`.
    - `stop [n, 8]`: What a limit does there. MuJoCo's two numbers of `solref`, five of `solimp`,
      and the joint's inverse weight (1 / (kg m^2) or 1 / kg).
    - `rub [n, 2]`: How dry friction gives, zeros where it is sharp. The rate 1/s at which it ends
      a speed, and what it adds to the joint's inverse weight.
    - `gravcomp [n, 10]`: Inertial parameters of what is held up against gravity, where
      `compensated`.
    - `linear`: Its equations of motion are those about rest at zero (`equations.py`).
    """

    joint_names: tuple[str, ...]
    kinds: tuple[str, ...]  # hinge or slide
    parent: tuple[int, ...]
    body_names: tuple[str, ...]
    limited: tuple[bool, ...]
    compensated: tuple[bool, ...]
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
    stop: Array
    rub: Array
    gravcomp: Array
    whole: Whole | None = None
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
        """Bodies that only join two joints of one body: they weigh nothing, whatever `inertial` a
        function is given.
        """
        return tuple(shape.massless for shape in self.shapes)

    def unit(self, joint: int) -> str:
        """Of the joint's coordinate."""
        if self.kinds[joint] == "hinge":
            return "rad"
        return "m"


def compensated(tree: Tree, share: float) -> Tree:
    """The tree with a share of every body's weight held up, whatever it was before."""
    if tree.whole is not None:
        every = compensated(tree.whole.tree, share)
        return replace(tree, whole=replace(tree.whole, tree=every))
    rows = share * np.asarray(tree.inertial)
    on = tuple(bool(np.any(row)) for row in rows)
    return replace(tree, gravcomp=rows, compensated=on)


_OF_EACH = ("joint_names", "kinds", "parent", "body_names", "limited", "compensated", "shapes")
_META = (*_OF_EACH, "linear")
_DATA = tuple(f.name for f in fields(Tree) if f.name not in _META)
_OF_JOINTS = tuple(name for name in _DATA if name not in ("gravity", "whole"))
_SIZES = {
    "damping_poly": (2,),
    "stiffness_poly": (2,),
    "range": (2,),
    "stop": (8,),
    "rub": (2,),
    "gravcomp": (10,),
}
jax.tree_util.register_dataclass(Tree, data_fields=_DATA, meta_fields=_META)


def make_tree(
    kinds: Sequence[str],
    parent: Sequence[int],
    place: Any,
    rotation: Any,
    inertial: Any,
    *,
    joint_names: Sequence[str] = (),
    body_names: Sequence[str] = (),
    **values: Any,
) -> Tree:
    """A tree from arrays as `Tree` has them.

    Args:
        kinds: [n], `hinge` or `slide`.
        parent: [n], the joint before each, -1 for none.
        place, rotation, inertial: `[n, 3]`, `[n, 3, 3]`, `[n, 10]`.
        joint_names, body_names: numbered where not given.
        values: other fields of `Tree`. Gravity is -9.81 along z where not given, no joint is
            limited, all else is zero.

    Returns:
        The tree. Raises ValueError where sizes do not agree or a joint comes before its parent.
    """
    n = len(kinds)
    gravity, limited = values.pop("gravity", (0.0, 0.0, -9.81)), values.pop("limited", ())
    if any(k not in ("hinge", "slide") for k in kinds):
        raise ValueError(f"kinds {tuple(kinds)} must be 'hinge' or 'slide'")
    if len(parent) != n or any(not -1 <= p < i for i, p in enumerate(parent)):
        raise ValueError(
            f"parent {tuple(parent)} must name an earlier joint, or -1, for each of {n} joints"
        )
    arrays: dict[str, Any] = {"place": place, "rotation": rotation, "inertial": inertial}
    sizes = {"place": (3,), "rotation": (3, 3), "inertial": (10,)} | _SIZES
    for name in _OF_JOINTS:
        shape = (n, *sizes.get(name, ()))
        if name not in arrays:
            arrays[name] = values.pop(name, np.zeros(shape))
        arrays[name] = np.asarray(arrays[name], float)
        if arrays[name].shape != shape:
            raise ValueError(f"{name} has shape {arrays[name].shape}, but {n} joints need {shape}")
    if values:
        raise ValueError(f"a tree has no {', '.join(values)}")
    snapped = {name: _snapped(arrays[name]) for name in ("place", "rotation")}
    rest: dict[str, Any] = arrays | snapped
    compensated = tuple(bool(np.any(row)) for row in arrays["gravcomp"])
    joint_names = tuple(joint_names) or tuple(f"joint{i + 1}" for i in range(n))
    body_names = tuple(body_names) or tuple(f"body{i + 1}" for i in range(n))
    tree = Tree(
        joint_names,
        tuple(kinds),
        tuple(int(p) for p in parent),
        body_names,
        tuple(map(bool, limited)) or (False,) * n,
        compensated,
        (),
        gravity=np.asarray(gravity, float),
        **rest,
    )
    return reshaped(tree)


def reshaped(tree: Tree) -> Tree:
    """The tree with `shapes` found anew, after `place`, `rotation` or `inertial` were replaced by
    other numbers.
    """
    place, rotation, inertial = (
        np.asarray(x, float) for x in (tree.place, tree.rotation, tree.inertial)
    )
    shapes = []
    for i in range(tree.n):
        zeros = tuple(0 if x == 0 else None for x in place[i])
        turns = tuple(
            tuple(int(x) if x in (-1.0, 0.0, 1.0) else None for x in row) for row in rotation[i]
        )
        shapes.append(Shape(zeros, turns, bool(np.all(inertial[i] == 0))))
    return replace(tree, shapes=tuple(shapes))


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
    """Groups of joints that share no moving body, hence no inertia: each may be simulated and
    fitted by itself.
    """
    if tree.whole is not None:
        return _tied(tree.whole, tree.n)
    root: list[int] = []
    for i, p in enumerate(tree.parent):
        root.append(i if p < 0 else root[p])
    return [tuple(i for i in range(tree.n) if root[i] == r) for r in sorted(set(root))]


def _tied(whole: Whole, n: int) -> list[tuple[int, ...]]:
    """Groups of coordinates that share a moving body, or a follower's."""
    group = list(range(n))
    for part in subtrees(whole.tree):
        mine = {group[whole.leader[k]] for k in part}
        group = [min(mine) if g in mine else g for g in group]
    return [tuple(j for j in range(n) if group[j] == g) for g in sorted(set(group))]


def take(tree: Tree, indices: Sequence[int]) -> Tree:
    """The joints `indices`, in that order, as a tree of their own. Raises ValueError where a parent
    would be missing.
    """
    new = {old: i for i, old in enumerate(indices)}
    if len(new) != len(indices):
        raise ValueError(f"indices {tuple(indices)} name a joint twice")
    missing = sorted({tree.parent[i] for i in indices} - set(new) - {-1})
    if missing:
        raise ValueError(
            f"joints {tuple(indices)} hang on {[tree.joint_names[i] for i in missing]}; take those "
            "as well"
        )
    if any(new.get(tree.parent[i], -1) > new[i] for i in indices):
        raise ValueError(f"indices {tuple(indices)} must name a joint after its parent")
    at = np.asarray(indices, int)
    meta = {name: tuple(getattr(tree, name)[i] for i in indices) for name in _OF_EACH}
    meta["parent"] = tuple(new.get(p, -1) for p in meta["parent"])
    whole = None if tree.whole is None else _taken(tree.whole, new)
    return replace(
        tree, **meta, **{name: getattr(tree, name)[at] for name in _OF_JOINTS}, whole=whole
    )


def _taken(whole: Whole, new: dict[int, int]) -> Whole | None:
    """What of `whole` goes with the coordinates `new` (old number: new one); None where nothing
    follows anything.
    """
    joints = [k for k, leader in enumerate(whole.leader) if leader in new]
    if len(joints) == len(new):
        return None
    place = {k: i for i, k in enumerate(joints)}
    own = {new[whole.leader[k]]: place[k] for k in joints if whole.own[whole.leader[k]] == k}
    at = np.asarray(joints, int)
    factor, offset = np.asarray(whole.factor)[at], np.asarray(whole.offset)[at]
    leader = tuple(new[whole.leader[k]] for k in joints)
    leading = tuple(own[j] for j in range(len(new)))
    return Whole(take(whole.tree, joints), leader, leading, factor, offset)


def folded(tree: Tree, leader: Sequence[int], factor: Any, offset: Any) -> Tree:
    """`tree` of m joints with those that follow others taken out of its coordinates.

    Raises ValueError where a leader follows another.

    Args:
        leader [m]: The joint that each follows (itself where it follows none).
        factor, offset [m]: It is at offset + factor * (its leader's angle). What is linear in the
            joints' own motion is added up. A spring of a follower keeps its force (its rest moves
            the leader's).
    """
    m = tree.n
    if any(leader[leader[k]] != leader[k] for k in range(m)):
        raise ValueError(f"leader {tuple(leader)}: a joint that is followed must follow none")
    own = [k for k in range(m) if leader[k] == k]
    if len(own) == m:
        return tree
    number = {k: j for j, k in enumerate(own)}
    goes = tuple(number[leader[k]] for k in range(m))
    c, d = np.asarray(factor, float), np.asarray(offset, float)

    together = [[k for k in range(m) if goes[k] == j] for j in range(len(own))]

    def summed(x):
        return np.stack([sum(x[k] for k in joints) for joints in together])

    size, square = np.abs(c), c**2
    powers = size[:, None] ** [3, 4]
    values = {
        "damping": summed(square * tree.damping),
        "armature": summed(square * tree.armature),
        "frictionloss": summed(size * tree.frictionloss),
        "stiffness": summed(square * tree.stiffness),
        "damping_poly": summed(powers * tree.damping_poly),
        "stiffness_poly": summed(powers * tree.stiffness_poly),
    }
    pull = summed(c * tree.stiffness * (tree.springref - d))
    stiff = values["stiffness"]
    rest = pull / np.where(stiff > 0, stiff, 1.0)
    values["springref"] = np.where(stiff > 0, rest, tree.springref[own])
    meta = {name: tuple(getattr(tree, name)[k] for k in own) for name in _OF_EACH}
    meta["parent"] = tuple(_parent(tree, k, goes, j) for j, k in enumerate(own))
    rest = {name: getattr(tree, name)[np.asarray(own)] for name in _OF_JOINTS if name not in values}
    whole = Whole(tree, goes, tuple(own), c, d)
    return replace(tree, **meta, **values, **rest, whole=whole)


def _parent(tree: Tree, joint: int, goes: Sequence[int], coordinate: int) -> int:
    """The nearest coordinate before a joint that is not its own and has a smaller number."""
    return next((goes[k] for k in ancestors(tree, joint) if goes[k] < coordinate), -1)
