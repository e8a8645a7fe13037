"""Mechanisms from MJCF and URDF, read by MuJoCo's own parser and compiler, as trees that
`dynamics.py` can simulate.
"""

import os
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.mechanisms.inertia_frames import frame_along, inertial_about, moved
from adaptsim_jax.mechanisms.roles import BALL, FREE, JOINTS, TURNS, Roles, roles, tendon_joints
from adaptsim_jax.mechanisms.spec import Source, read_source
from adaptsim_jax.mechanisms.switches import has_off
from adaptsim_jax.mechanisms.transmission import (
    TENDON,
    Actuator,
    Added,
    Place,
    add_tendons,
    read_actuators,
)
from adaptsim_jax.mechanisms.tree import MOST_JOINTS, Tree, folded, make_tree

HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)


@dataclass(frozen=True)
class Frames:
    """Where MJCF's own bodies are, by name.

    - `carrier`: The coordinate whose body each is part of (-1: the base, or a follower).
    - `place [3]`, `rotation [3, 3]`: Its frame in that joint's frame (in the world at the base).
    """

    carrier: dict[str, int]
    place: dict[str, np.ndarray]
    rotation: dict[str, np.ndarray]


@dataclass(frozen=True)
class Mechanism:
    """What a file says.

    - `source`: The one of mjcf and urdf.
    - `notes`: Sentences on how it was read.
    - `beyond`: What the file has and a tree has not, of the mechanism itself, a sentence each.
    - `drives_beyond`: The same of its actuators.
    - `force_limits [n, 2]`: Of all actuators of a joint together (nan: nothing bounds them).
    - `roles`: What each joint of the file became.
    """

    tree: Tree
    actuators: tuple[Actuator, ...]
    path: str
    source: str
    notes: tuple[str, ...]
    force_limits: np.ndarray
    frames: Frames
    beyond: tuple[str, ...] = ()
    drives_beyond: tuple[str, ...] = ()
    roles: Roles | None = None


def read_mechanism(path: str | os.PathLike) -> Mechanism:
    """Read an MJCF or URDF file with all its joints: a base that stands still and 1 to 64 hinges or
    slides (three for a ball).

    Raises BadInput, naming the file, the joint or element, and the mend.
    """
    return mechanism_of(read_source(path))


def mechanism_of(
    source: Source,
    hold: Mapping[str, float | None] | None = None,
    logged: Collection[str] | None = None,
    where: str = "",
) -> Mechanism:
    """The tree of a file.

    Raises BadInput, naming the file, the joint or element, and the mend.

    Args:
        hold, logged, where: See `roles.roles`.
    """
    model = source.model
    role = roles(source, hold or {}, logged, where)
    walk = _Walk(model, role)
    moving = len(walk.kinds) - len(role.followers)
    if moving > MOST_JOINTS:
        raise BadInput(
            f"{source.path}: {moving} joints move, more than "
            f"{MOST_JOINTS}; hold some: [hold] in meta.toml, {walk.names[-1]} = 0.0"
        )
    tree = _tree(model, walk, source.weightless)
    leader, factor, offset = walk.followed(role)
    tree = _in_reach(folded(tree, leader, factor, offset))
    place = walk.places(role, leader, factor, offset)
    added = Added(*np.zeros((5, tree.n)), beyond=[])
    add_tendons(model, place, added)
    own, added.beyond = tuple(added.beyond), []
    actuators, idle = read_actuators(model, place, added)
    tree = _with_added(tree, added)
    notes = (
        *source.notes,
        *role.notes,
        *((f"actuators of held joints, or off, do nothing: {', '.join(idle)}",) if idle else ()),
    )
    beyond = (*role.beyond, *walk.beyond, *own, *_medium(model), *_curved(tree))
    if bounded := [
        model.joint(k).name
        for k in range(model.njnt)
        if model.ngravcomp and model.jnt_actgravcomp[k] and model.jnt_actfrclimited[k]
    ]:
        added.beyond.append(
            f"gravity compensation within the force limits of {len(bounded)} joints ({bounded[0]}, "
            "...)"
        )
    return Mechanism(
        tree,
        actuators,
        source.path,
        source.kind,
        notes,
        _force_limits(model, tree, place),
        walk.frames(tree),
        beyond,
        tuple(added.beyond),
        role,
    )


class _Walk:
    """The bodies of a model, from the base outwards: joints that move, and what each carries.

    Lists by joint of the tree of all joints: kinds, parent, names, body_names, place, rotation.
    Also `file` (its number in the file, of a ball with which of its three turns), and
    `inertial`, `gravcomp [m, 10]`.
    """

    def __init__(self, model: mujoco.MjModel, role: Roles):
        self.model, self.role = model, role
        self.kinds: list[str] = []
        self.parent: list[int] = []
        self.names: list[str] = []
        self.body_names: list[str] = []
        self.place: list[np.ndarray] = []
        self.rotation: list[np.ndarray] = []
        self.file: list[tuple[int, int]] = []
        self.beyond: list[str] = []
        self.carrier: list[int] = [-1]
        self.frame: list[tuple[np.ndarray, np.ndarray]] = [(np.zeros(3), np.eye(3))]
        for b in range(1, model.nbody):
            self._body(b)
        self.inertial, self.gravcomp = np.zeros((2, len(self.kinds), 10))
        for b in range(1, model.nbody):
            self._weigh(b)

    def _body(self, b: int) -> None:
        model = self.model
        up = int(model.body_parentid[b])
        at, turn = moved(self.frame[up], (model.body_pos[b], rotation_of(model.body_quat[b])))
        on = self.carrier[up]
        first = int(model.body_jntadr[b])
        for k in range(first, first + int(model.body_jntnum[b])):
            name, kind = model.joint(k).name, int(model.jnt_type[k])
            rest = model.qpos0[model.jnt_qposadr[k]]
            if name in self.role.held:
                at, turn = _held((at, turn), model, k, self.role.held[name])
                continue
            if kind == BALL:
                at, turn, on = self._ball((at, turn), on, k, b)
                continue
            along = frame_along(model.jnt_axis[k])
            frame = turn @ along
            anchor = at + turn @ model.jnt_pos[k]
            if kind == HINGE:
                self._joint("hinge", on, name, b, (k, 0), anchor, frame @ _about_z(-rest))
            else:
                anchor = anchor - turn @ model.jnt_axis[k] * rest
                self._joint("slide", on, name, b, (k, 0), anchor, frame @ np.eye(3))
            at, turn, on = -along.T @ model.jnt_pos[k], along.T, len(self.kinds) - 1
        self.carrier.append(on)
        self.frame.append((at, turn))

    def _joint(self, kind, parent, name, body, file, place, rotation) -> None:
        self.kinds.append(kind)
        self.parent.append(parent)
        self.names.append(name)
        self.place.append(place)
        self.rotation.append(rotation)
        self.file.append(file)
        body_name = self.model.body(body).name
        for i, other in enumerate(self.body_names):
            if other == body_name:  # only the last joint of a body carries it
                self.body_names[i] = f"{body_name}:{self.names[i]}"
        self.body_names.append(body_name)

    def _ball(self, frame, on: int, k: int, body: int):
        """Three hinges about x, then y, then z, which turn the body as the ball does."""
        model, (at, turn) = self.model, frame
        name = model.joint(k).name
        self.beyond.append(f"ball joint '{name}' as more than three hinges in turn")
        for axis, unit in zip(TURNS, np.eye(3), strict=True):
            along = frame_along(unit)
            anchor = at + turn @ model.jnt_pos[k]
            file = k, TURNS.index(axis)
            self._joint("hinge", on, f"{name}_{axis}", body, file, anchor, turn @ along)
            at, turn, on = -along.T @ model.jnt_pos[k], along.T, len(self.kinds) - 1
        return at, turn, on

    def _weigh(self, b: int) -> None:
        model, (on, (at, turn)) = self.model, (self.carrier[b], self.frame[b])
        if on < 0:
            return
        centre = at + turn @ model.body_ipos[b]
        axes = turn @ rotation_of(model.body_iquat[b])
        own = inertial_about(model.body_mass[b], centre, axes, model.body_inertia[b])
        self.inertial[on] += own
        self.gravcomp[on] += model.body_gravcomp[b] * own

    def followed(self, role: Roles) -> tuple[list[int], np.ndarray, np.ndarray]:
        """leader, factor and offset of each joint, as `tree.folded` takes them."""
        number = {name: i for i, name in enumerate(self.names)}
        count = len(self.names)
        leader, factor, offset = list(range(count)), np.ones(count), np.zeros(count)
        for f in role.followers.values():
            i = number[f.joint]
            leader[i], factor[i], offset[i] = number[f.leader], f.factor, f.offset
        return leader, factor, offset

    def places(self, role: Roles, leader, factor, offset) -> Place:
        """Of each joint of the file."""
        model = self.model
        own = [i for i in range(len(leader)) if leader[i] == i]
        number = {i: j for j, i in enumerate(own)}
        out = Place(np.full(model.njnt, -1), np.ones(model.njnt), np.zeros(model.njnt))
        for i, (k, _) in enumerate(self.file):
            out.coordinate[k] = number[leader[i]]
            out.factor[k] = factor[i]
            out.offset[k] = offset[i]
        for k in range(model.njnt):
            value = role.held.get(model.joint(k).name)
            if value is not None and len(value) == 1:
                out.offset[k] = value[0]
        return out

    def frames(self, tree: Tree) -> Frames:
        own = tuple(range(tree.n)) if tree.whole is None else tree.whole.own
        number = {i: j for j, i in enumerate(own)}
        names = [self.model.body(b).name for b in range(self.model.nbody)]
        carrier = {name: number.get(on, -1) for name, on in zip(names, self.carrier, strict=True)}
        frame = dict(zip(names, self.frame, strict=True))
        place = {name: at for name, (at, _) in frame.items()}
        return Frames(carrier, place, {name: turn for name, (_, turn) in frame.items()})


def _held(frame, model: mujoco.MjModel, k: int, value: np.ndarray):
    """The frame of a body after its joint k, which is held at a value."""
    kind, adr = int(model.jnt_type[k]), int(model.jnt_qposadr[k])
    if kind == FREE:
        return value[:3].copy(), rotation_of(value[3:] / np.linalg.norm(value[3:]))
    at, turn = frame
    if kind == BALL:
        own = rotation_of(value)
    elif kind == HINGE:
        along = frame_along(model.jnt_axis[k])
        own = along @ _about_z(value[0] - model.qpos0[adr]) @ along.T
    else:
        return at + turn @ model.jnt_axis[k] * (value[0] - model.qpos0[adr]), turn
    pivot = model.jnt_pos[k]
    return at + turn @ (pivot - own @ pivot), turn @ own


def _tree(model: mujoco.MjModel, walk: _Walk, weightless: Collection[str]) -> Tree:
    """The tree of all joints that are not held."""
    joint = np.array([k for k, _ in walk.file], int)
    turn = np.array([t for _, t in walk.file], int)
    ball = model.jnt_type[joint] == BALL
    dof, adr = model.jnt_dofadr[joint] + turn, model.jnt_qposadr[joint]
    inertial = walk.inertial.copy()
    # a link without any inertia was given a little, so that MuJoCo reads it
    for i in range(len(joint)):
        own = [model.body(b).name for b in range(model.nbody) if walk.carrier[b] == i]
        if own and all(name in weightless for name in own):
            inertial[i] = 0.0
    weight = model.dof_invweight0[dof]
    stop = np.concatenate([model.jnt_solref[joint], model.jnt_solimp[joint], weight[:, None]], 1)
    minimum = 0.0 if has_off(model, "refsafe") else 2 * model.opt.timestep
    lag = stop[:, 0]
    stop[:, 0] = np.where(lag > 0, np.maximum(lag, minimum), lag)
    rub = _rubs(model.dof_solref[dof], model.dof_solimp[dof], weight, minimum)
    limited = [bool(x) for x in model.jnt_limited[joint] & ~ball]
    place = np.array(walk.place).reshape(-1, 3)
    rotation = np.array(walk.rotation).reshape(-1, 3, 3)
    return make_tree(
        walk.kinds,
        walk.parent,
        place,
        rotation,
        inertial,
        gravity=model.opt.gravity,
        joint_names=walk.names,
        body_names=walk.body_names,
        limited=limited,
        damping=model.dof_damping[dof],
        damping_poly=model.dof_dampingpoly[dof],
        armature=model.dof_armature[dof],
        frictionloss=model.dof_frictionloss[dof],
        stiffness=model.jnt_stiffness[joint],
        stiffness_poly=model.jnt_stiffnesspoly[joint],
        springref=np.where(ball, 0.0, model.qpos_spring[adr]),
        range=np.where(ball[:, None], 0.0, model.jnt_range[joint]),
        stop=stop,
        rub=rub,
        gravcomp=walk.gravcomp,
    )


def _rubs(solref: np.ndarray, solimp: np.ndarray, weight: np.ndarray, minimum: float) -> np.ndarray:
    """How dry friction gives `[n, 2]`, as of `Tree`.

    Friction loss has no position, so that its impedance is the first of `solimp` and its reference
    acceleration is -b v (MuJoCo's documentation, "Computation", constraint model).

    Args:
        solref, solimp, weight: Of `n` joints.
        minimum: Of a time constant, s.
    """
    time, ratio, most = solref[:, 0], solref[:, 1], solimp[:, 1]
    direct = time <= 0
    rate = np.where(
        direct, -ratio / most, 2.0 / (most * np.where(direct, 1.0, np.maximum(time, minimum)))
    )
    share = np.clip(solimp[:, 0], 1e-4, 1.0 - 1e-4)
    return np.stack([rate, (1.0 - share) / share * weight], 1)


def _with_added(tree: Tree, added: Added) -> Tree:
    """With what tendons and actuators add to the joints' own."""
    stiff = tree.stiffness + added.stiffness
    pull = tree.stiffness * tree.springref + added.pull
    rest = pull / np.where(stiff > 0, stiff, 1.0)
    return replace(
        tree,
        armature=tree.armature + added.armature,
        damping=tree.damping + added.damping,
        frictionloss=tree.frictionloss + added.frictionloss,
        stiffness=stiff,
        springref=np.where(added.stiffness > 0, rest, tree.springref),
    )


def _force_limits(model: mujoco.MjModel, tree: Tree, place: Place) -> np.ndarray:
    """[n, 2] of what actuators together do to each coordinate, nan where nothing bounds it: summed
    over its driven joints.
    """
    driven = set()
    for k in range(model.nu):
        target = int(model.actuator_trnid[k, 0])
        if model.actuator_trntype[k] in JOINTS:
            driven.add(target)
        elif model.actuator_trntype[k] == TENDON:
            driven |= set(tendon_joints(model, target))
    out = np.zeros((tree.n, 2))
    bounded = np.zeros(tree.n, bool)
    for k in sorted(driven):
        if (j := int(place.coordinate[k])) >= 0:
            if model.jnt_actfrclimited[k]:
                own = place.factor[k] * model.jnt_actfrcrange[k]
            else:
                own = [-np.inf, np.inf]
            out[j] += np.sort(own)
            bounded[j] = True
    return np.where(bounded[:, None] & np.isfinite(out), out, np.nan)


def _in_reach(tree: Tree) -> Tree:
    """With the ranges of joints that follow others put on their leaders'."""
    whole = tree.whole
    if whole is None:
        return tree
    every, bounds, limited = whole.tree, np.array(tree.range, float), list(tree.limited)
    for k, j in enumerate(whole.leader):
        if every.limited[k] and k != whole.own[j]:
            own = np.sort((np.asarray(every.range)[k] - whole.offset[k]) / whole.factor[k])
            if limited[j]:
                bounds[j] = [max(bounds[j, 0], own[0]), min(bounds[j, 1], own[1])]
            else:
                bounds[j] = own
            limited[j] = True
    return replace(tree, range=bounds, limited=tuple(limited))


def _medium(model: mujoco.MjModel) -> tuple[str, ...]:
    if model.opt.density or model.opt.viscosity:
        return ("the drag of a medium (density, viscosity)",)
    return ()


def _curved(tree: Tree) -> tuple[str, ...]:
    """Polynomials that effects of joints do not have."""
    if np.any(tree.damping_poly[:, 1]) or np.any(tree.stiffness_poly):
        return ("damping with the cube of the speed, or a spring that is not straight",)
    return ()


def rotation_of(quaternion: np.ndarray) -> np.ndarray:
    """[3, 3] of a unit quaternion [4], the scalar first."""
    out = np.zeros(9)
    mujoco.mju_quat2Mat(out, quaternion)
    return out.reshape(3, 3)


def _about_z(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
