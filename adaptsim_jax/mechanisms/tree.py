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
its own: `all_joints` then has the tree of all joints, and the coordinate that each goes with.
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
class AllJoints:
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
    AllJoints, data_fields=["tree", "factor", "offset"], meta_fields=["leader", "own"]
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
    - `stop_params [n, 8]`: What a limit does there. MuJoCo's two numbers of `solref`, five of
      `solimp`, and the joint's inverse weight (1 / (kg m^2) or 1 / kg).
    - `friction_softness [n, 2]`: How dry friction gives, zeros where it is sharp. The rate 1/s at
      which it ends a speed, and what it adds to the joint's inverse weight.
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
    stop_params: Array
    friction_softness: Array
    gravcomp: Array
    all_joints: AllJoints | None = None
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
        """Return the unit of the joint's coordinate."""
        if self.kinds[joint] == "hinge":
            return "rad"
        return "m"


def with_compensation(tree: Tree, share: float) -> Tree:
    """Return the tree with a share of every body's weight held up, whatever it was before."""
    if tree.all_joints is not None:
        full = with_compensation(tree.all_joints.tree, share)
        return replace(tree, all_joints=replace(tree.all_joints, tree=full))
    held_up = share * np.asarray(tree.inertial)
    is_compensated = tuple(bool(np.any(row)) for row in held_up)
    return replace(tree, gravcomp=held_up, compensated=is_compensated)


_OF_EACH = ("joint_names", "kinds", "parent", "body_names", "limited", "compensated", "shapes")
_META = (*_OF_EACH, "linear")
_DATA = tuple(f.name for f in fields(Tree) if f.name not in _META)
_OF_JOINTS = tuple(name for name in _DATA if name not in ("gravity", "all_joints"))
_SIZES = {
    "damping_poly": (2,),
    "stiffness_poly": (2,),
    "range": (2,),
    "stop_params": (8,),
    "friction_softness": (2,),
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
    return with_static_entries(tree)


def with_static_entries(tree: Tree) -> Tree:
    """Return the tree with the `shapes` (exact -1, 0 and 1) of its `place`, `rotation` and
    `inertial`, which may have been replaced by other numbers.
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
    rounded = np.round(x)
    return np.where((np.abs(x - rounded) < EXACT) & (np.abs(rounded) <= 1), rounded, x)


def ancestors(tree: Tree, joint: int) -> tuple[int, ...]:
    """Return the joints that carry a joint, the nearest first."""
    out = []
    while (joint := tree.parent[joint]) >= 0:
        out.append(joint)
    return tuple(out)


def subtrees(tree: Tree) -> list[tuple[int, ...]]:
    """Groups of joints that share no moving body, hence no inertia: each may be simulated and
    fitted by itself.
    """
    if tree.all_joints is not None:
        return _subtrees_of_all(tree.all_joints, tree.n)
    root: list[int] = []
    for i, p in enumerate(tree.parent):
        root.append(i if p < 0 else root[p])
    return [tuple(i for i in range(tree.n) if root[i] == r) for r in sorted(set(root))]


def _subtrees_of_all(all_joints: AllJoints, n: int) -> list[tuple[int, ...]]:
    """Groups of coordinates that share a moving body, or a follower's."""
    group = list(range(n))
    for part in subtrees(all_joints.tree):
        shared = {group[all_joints.leader[k]] for k in part}
        group = [min(shared) if g in shared else g for g in group]
    return [tuple(j for j in range(n) if group[j] == g) for g in sorted(set(group))]


def take(tree: Tree, indices: Sequence[int]) -> Tree:
    """The joints `indices`, in that order, as a tree of their own. Raises ValueError where a parent
    would be missing.
    """
    new_index = {old: i for i, old in enumerate(indices)}
    if len(new_index) != len(indices):
        raise ValueError(f"indices {tuple(indices)} name a joint twice")
    missing_parents = sorted({tree.parent[i] for i in indices} - set(new_index) - {-1})
    if missing_parents:
        raise ValueError(
            f"joints {tuple(indices)} hang on {[tree.joint_names[i] for i in missing_parents]}; "
            "take those as well"
        )
    if any(new_index.get(tree.parent[i], -1) > new_index[i] for i in indices):
        raise ValueError(f"indices {tuple(indices)} must name a joint after its parent")
    at = np.asarray(indices, int)
    meta = {name: tuple(getattr(tree, name)[i] for i in indices) for name in _OF_EACH}
    meta["parent"] = tuple(new_index.get(p, -1) for p in meta["parent"])
    all_joints = None if tree.all_joints is None else _take_all_joints(tree.all_joints, new_index)
    return replace(
        tree,
        **meta,
        **{name: getattr(tree, name)[at] for name in _OF_JOINTS},
        all_joints=all_joints,
    )


def _take_all_joints(all_joints: AllJoints, new_index: dict[int, int]) -> AllJoints | None:
    """What of `all_joints` goes with the coordinates `new_index` (old number: new one); None where
    nothing follows anything.
    """
    joints = [k for k, leader in enumerate(all_joints.leader) if leader in new_index]
    if len(joints) == len(new_index):
        return None
    new_joint = {k: i for i, k in enumerate(joints)}
    own = {
        new_index[all_joints.leader[k]]: new_joint[k]
        for k in joints
        if all_joints.own[all_joints.leader[k]] == k
    }
    at = np.asarray(joints, int)
    factor, offset = np.asarray(all_joints.factor)[at], np.asarray(all_joints.offset)[at]
    leader = tuple(new_index[all_joints.leader[k]] for k in joints)
    leading = tuple(own[j] for j in range(len(new_index)))
    return AllJoints(take(all_joints.tree, joints), leader, leading, factor, offset)


def eliminate_followers(tree: Tree, leader: Sequence[int], factor: Any, offset: Any) -> Tree:
    """Remove the joints that follow others from the coordinates of a tree of m joints.

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
    coordinate_of = tuple(number[leader[k]] for k in range(m))
    c, d = np.asarray(factor, float), np.asarray(offset, float)

    joints_of_coordinate = [[k for k in range(m) if coordinate_of[k] == j] for j in range(len(own))]

    def sum_by_coordinate(x):
        return np.stack([sum(x[k] for k in joints) for joints in joints_of_coordinate])

    abs_factor, squared_factor = np.abs(c), c**2
    factor_powers = abs_factor[:, None] ** [3, 4]
    values = {
        "damping": sum_by_coordinate(squared_factor * tree.damping),
        "armature": sum_by_coordinate(squared_factor * tree.armature),
        "frictionloss": sum_by_coordinate(abs_factor * tree.frictionloss),
        "stiffness": sum_by_coordinate(squared_factor * tree.stiffness),
        "damping_poly": sum_by_coordinate(factor_powers * tree.damping_poly),
        "stiffness_poly": sum_by_coordinate(factor_powers * tree.stiffness_poly),
    }
    spring_force = sum_by_coordinate(c * tree.stiffness * (tree.springref - d))
    stiffness = values["stiffness"]
    rest_position = spring_force / np.where(stiffness > 0, stiffness, 1.0)
    values["springref"] = np.where(stiffness > 0, rest_position, tree.springref[own])
    meta = {name: tuple(getattr(tree, name)[k] for k in own) for name in _OF_EACH}
    meta["parent"] = tuple(_parent(tree, k, coordinate_of, j) for j, k in enumerate(own))
    others = {
        name: getattr(tree, name)[np.asarray(own)] for name in _OF_JOINTS if name not in values
    }
    all_joints = AllJoints(tree, coordinate_of, tuple(own), c, d)
    return replace(tree, **meta, **values, **others, all_joints=all_joints)


def _parent(tree: Tree, joint: int, coordinate_of: Sequence[int], coordinate: int) -> int:
    """The nearest coordinate before a joint that is not its own and has a smaller number."""
    for k in ancestors(tree, joint):
        if coordinate_of[k] < coordinate:
            return coordinate_of[k]
    return -1
