"""Mechanisms from MJCF and URDF, read by MuJoCo's own parser and compiler, as trees that
`dynamics.py` can simulate.
"""

import os
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.mechanisms.inertia_frames import compose, frame_along, inertial_about
from adaptsim_jax.mechanisms.roles import (
    BALL,
    BALL_AXES,
    FREE,
    JOINT_TRANSMISSIONS,
    Roles,
    assign_roles,
    tendon_joints,
)
from adaptsim_jax.mechanisms.spec import Source, read_source
from adaptsim_jax.mechanisms.switches import has_off
from adaptsim_jax.mechanisms.transmission import (
    TENDON,
    Actuator,
    CoordinateMap,
    PassiveElements,
    add_tendons,
    read_actuators,
)
from adaptsim_jax.mechanisms.tree import MOST_JOINTS, Tree, eliminate_followers, make_tree

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
    - `unsupported`: Features of the mechanism itself that a tree lacks, a sentence each.
    - `unsupported_drives`: The same of its actuators.
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
    unsupported: tuple[str, ...] = ()
    unsupported_drives: tuple[str, ...] = ()
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
    """Build the mechanism of a compiled file.

    Raises BadInput, naming the file, the joint or element, and the mend.

    Args:
        hold, logged, where: See `roles.assign_roles`.
    """
    model = source.model
    roles = assign_roles(source, hold or {}, logged, where)
    walk = _Walk(model, roles)
    n_moving = len(walk.kinds) - len(roles.followers)
    if n_moving > MOST_JOINTS:
        raise BadInput(
            f"{source.path}: {n_moving} joints move, more than "
            f"{MOST_JOINTS}; hold some: [hold] in meta.toml, {walk.names[-1]} = 0.0"
        )
    tree = _tree(model, walk, source.weightless)
    leader, factor, offset = walk.follower_arrays(roles)
    tree = _with_follower_ranges(eliminate_followers(tree, leader, factor, offset))
    coordinates = walk.coordinate_map(roles, leader, factor, offset)
    passive = PassiveElements(*np.zeros((5, tree.n)), unsupported=[])
    add_tendons(model, coordinates, passive)
    tendons_unsupported, passive.unsupported = tuple(passive.unsupported), []
    actuators, idle_actuators = read_actuators(model, coordinates, passive)
    tree = _with_passive(tree, passive)
    notes = (
        *source.notes,
        *roles.notes,
        *(
            (f"actuators of held joints, or off, do nothing: {', '.join(idle_actuators)}",)
            if idle_actuators
            else ()
        ),
    )
    unsupported = (
        *roles.unsupported,
        *walk.unsupported,
        *tendons_unsupported,
        *_medium(model),
        *_curved(tree),
    )
    if limited_joints := [
        model.joint(k).name
        for k in range(model.njnt)
        if model.ngravcomp and model.jnt_actgravcomp[k] and model.jnt_actfrclimited[k]
    ]:
        passive.unsupported.append(
            f"gravity compensation within the force limits of {len(limited_joints)} joints "
            f"({limited_joints[0]}, ...)"
        )
    return Mechanism(
        tree,
        actuators,
        source.path,
        source.kind,
        notes,
        _force_limits(model, tree, coordinates),
        walk.frames(tree),
        unsupported,
        tuple(passive.unsupported),
        roles,
    )


class _Walk:
    """The bodies of a model, from the base outwards: joints that move, and what each carries.

    Lists by joint of the tree of all joints: kinds, parent, names, body_names, place, rotation.
    Also `file` (its number in the file, of a ball with which of its three turns), and
    `inertial`, `gravcomp [m, 10]`.
    """

    def __init__(self, model: mujoco.MjModel, roles: Roles):
        self.model, self.roles = model, roles
        self.kinds: list[str] = []
        self.parent: list[int] = []
        self.names: list[str] = []
        self.body_names: list[str] = []
        self.place: list[np.ndarray] = []
        self.rotation: list[np.ndarray] = []
        self.file: list[tuple[int, int]] = []
        self.unsupported: list[str] = []
        self.carrier: list[int] = [-1]
        self.frame: list[tuple[np.ndarray, np.ndarray]] = [(np.zeros(3), np.eye(3))]
        for b in range(1, model.nbody):
            self._body(b)
        self.inertial, self.gravcomp = np.zeros((2, len(self.kinds), 10))
        for b in range(1, model.nbody):
            self._add_inertia(b)

    def _body(self, b: int) -> None:
        model = self.model
        parent = int(model.body_parentid[b])
        place, rotation = compose(
            self.frame[parent], (model.body_pos[b], rotation_of(model.body_quat[b]))
        )
        carrier = self.carrier[parent]
        first_joint = int(model.body_jntadr[b])
        for k in range(first_joint, first_joint + int(model.body_jntnum[b])):
            name, kind = model.joint(k).name, int(model.jnt_type[k])
            rest = model.qpos0[model.jnt_qposadr[k]]
            if name in self.roles.held:
                place, rotation = _fixed_joint_frame(
                    (place, rotation), model, k, self.roles.held[name]
                )
                continue
            if kind == BALL:
                place, rotation, carrier = self._ball((place, rotation), carrier, k, b)
                continue
            along = frame_along(model.jnt_axis[k])
            frame = rotation @ along
            anchor = place + rotation @ model.jnt_pos[k]
            if kind == HINGE:
                self._joint("hinge", carrier, name, b, (k, 0), anchor, frame @ _about_z(-rest))
            else:
                anchor = anchor - rotation @ model.jnt_axis[k] * rest
                self._joint("slide", carrier, name, b, (k, 0), anchor, frame @ np.eye(3))
            place, rotation, carrier = -along.T @ model.jnt_pos[k], along.T, len(self.kinds) - 1
        self.carrier.append(carrier)
        self.frame.append((place, rotation))

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

    def _ball(self, frame, carrier: int, k: int, body: int):
        """Three hinges about x, then y, then z, which turn the body as the ball does."""
        model, (place, rotation) = self.model, frame
        name = model.joint(k).name
        self.unsupported.append(f"ball joint '{name}' as more than three hinges in turn")
        for axis, axis_vector in zip(BALL_AXES, np.eye(3), strict=True):
            along = frame_along(axis_vector)
            anchor = place + rotation @ model.jnt_pos[k]
            file = k, BALL_AXES.index(axis)
            self._joint("hinge", carrier, f"{name}_{axis}", body, file, anchor, rotation @ along)
            place, rotation, carrier = -along.T @ model.jnt_pos[k], along.T, len(self.kinds) - 1
        return place, rotation, carrier

    def _add_inertia(self, b: int) -> None:
        model, (carrier, (place, rotation)) = self.model, (self.carrier[b], self.frame[b])
        if carrier < 0:
            return
        centre = place + rotation @ model.body_ipos[b]
        axes = rotation @ rotation_of(model.body_iquat[b])
        inertial = inertial_about(model.body_mass[b], centre, axes, model.body_inertia[b])
        self.inertial[carrier] += inertial
        self.gravcomp[carrier] += model.body_gravcomp[b] * inertial

    def follower_arrays(self, roles: Roles) -> tuple[list[int], np.ndarray, np.ndarray]:
        """Return leader, factor and offset of each joint, as `tree.eliminate_followers` takes
        them.
        """
        number = {name: i for i, name in enumerate(self.names)}
        count = len(self.names)
        leader, factor, offset = list(range(count)), np.ones(count), np.zeros(count)
        for f in roles.followers.values():
            i = number[f.joint]
            leader[i], factor[i], offset[i] = number[f.leader], f.factor, f.offset
        return leader, factor, offset

    def coordinate_map(self, roles: Roles, leader, factor, offset) -> CoordinateMap:
        """Return the coordinate of each joint of the file."""
        model = self.model
        leaders = [i for i in range(len(leader)) if leader[i] == i]
        number = {i: j for j, i in enumerate(leaders)}
        coordinates = CoordinateMap(
            np.full(model.njnt, -1), np.ones(model.njnt), np.zeros(model.njnt)
        )
        for i, (k, _) in enumerate(self.file):
            coordinates.coordinate[k] = number[leader[i]]
            coordinates.factor[k] = factor[i]
            coordinates.offset[k] = offset[i]
        for k in range(model.njnt):
            value = roles.held.get(model.joint(k).name)
            if value is not None and len(value) == 1:
                coordinates.offset[k] = value[0]
        return coordinates

    def frames(self, tree: Tree) -> Frames:
        """Return where the file's bodies are."""
        own = tuple(range(tree.n)) if tree.all_joints is None else tree.all_joints.own
        number = {i: j for j, i in enumerate(own)}
        names = [self.model.body(b).name for b in range(self.model.nbody)]
        carrier = {name: number.get(on, -1) for name, on in zip(names, self.carrier, strict=True)}
        frame = dict(zip(names, self.frame, strict=True))
        place = {name: at for name, (at, _) in frame.items()}
        return Frames(carrier, place, {name: turn for name, (_, turn) in frame.items()})


def _fixed_joint_frame(frame, model: mujoco.MjModel, k: int, value: np.ndarray):
    """Return the frame of a body after its joint k, which is held at a value (rad or m)."""
    kind, adr = int(model.jnt_type[k]), int(model.jnt_qposadr[k])
    if kind == FREE:
        return value[:3].copy(), rotation_of(value[3:] / np.linalg.norm(value[3:]))
    place, rotation = frame
    if kind == BALL:
        joint_rotation = rotation_of(value)
    elif kind == HINGE:
        along = frame_along(model.jnt_axis[k])
        joint_rotation = along @ _about_z(value[0] - model.qpos0[adr]) @ along.T
    else:
        return place + rotation @ model.jnt_axis[k] * (value[0] - model.qpos0[adr]), rotation
    pivot = model.jnt_pos[k]
    return place + rotation @ (pivot - joint_rotation @ pivot), rotation @ joint_rotation


def _tree(model: mujoco.MjModel, walk: _Walk, weightless: Collection[str]) -> Tree:
    """The tree of all joints that are not held."""
    joint = np.array([k for k, _ in walk.file], int)
    axis = np.array([t for _, t in walk.file], int)
    ball = model.jnt_type[joint] == BALL
    dof, adr = model.jnt_dofadr[joint] + axis, model.jnt_qposadr[joint]
    inertial = walk.inertial.copy()
    # a link without any inertia was given a little, so that MuJoCo reads it
    for i in range(len(joint)):
        bodies = [model.body(b).name for b in range(model.nbody) if walk.carrier[b] == i]
        if bodies and all(name in weightless for name in bodies):
            inertial[i] = 0.0
    weight = model.dof_invweight0[dof]
    stop_params = np.concatenate(
        [model.jnt_solref[joint], model.jnt_solimp[joint], weight[:, None]], 1
    )
    minimum = 0.0 if has_off(model, "refsafe") else 2 * model.opt.timestep
    time_constant = stop_params[:, 0]
    stop_params[:, 0] = np.where(
        time_constant > 0, np.maximum(time_constant, minimum), time_constant
    )
    friction_softness = _friction_softness(
        model.dof_solref[dof], model.dof_solimp[dof], weight, minimum
    )
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
        stop_params=stop_params,
        friction_softness=friction_softness,
        gravcomp=walk.gravcomp,
    )


def _friction_softness(
    solref: np.ndarray, solimp: np.ndarray, weight: np.ndarray, minimum: float
) -> np.ndarray:
    """Return `friction_softness [n, 2]` of a `Tree`.

    Friction loss has no position, so that its impedance is the first of `solimp` and its reference
    acceleration is -b v (MuJoCo's documentation, "Computation", constraint model).

    Args:
        solref, solimp, weight: Of `n` joints.
        minimum: Of a time constant, s.
    """
    time, ratio, max_impedance = solref[:, 0], solref[:, 1], solimp[:, 1]
    is_direct = time <= 0
    rate = np.where(
        is_direct,
        -ratio / max_impedance,
        2.0 / (max_impedance * np.where(is_direct, 1.0, np.maximum(time, minimum))),
    )
    share = np.clip(solimp[:, 0], 1e-4, 1.0 - 1e-4)
    return np.stack([rate, (1.0 - share) / share * weight], 1)


def _with_passive(tree: Tree, passive: PassiveElements) -> Tree:
    """Add what tendons and actuators do passively to the joints' own."""
    stiffness = tree.stiffness + passive.stiffness
    spring_force = tree.stiffness * tree.springref + passive.pull
    rest_position = spring_force / np.where(stiffness > 0, stiffness, 1.0)
    return replace(
        tree,
        armature=tree.armature + passive.armature,
        damping=tree.damping + passive.damping,
        frictionloss=tree.frictionloss + passive.frictionloss,
        stiffness=stiffness,
        springref=np.where(passive.stiffness > 0, rest_position, tree.springref),
    )


def _force_limits(model: mujoco.MjModel, tree: Tree, coordinates: CoordinateMap) -> np.ndarray:
    """Sum the force limits [n, 2] (N m or N) of each coordinate over its driven joints; nan where
    nothing bounds it.
    """
    driven = set()
    for k in range(model.nu):
        target = int(model.actuator_trnid[k, 0])
        if model.actuator_trntype[k] in JOINT_TRANSMISSIONS:
            driven.add(target)
        elif model.actuator_trntype[k] == TENDON:
            driven |= set(tendon_joints(model, target))
    out = np.zeros((tree.n, 2))
    is_driven = np.zeros(tree.n, bool)
    for k in sorted(driven):
        if (j := int(coordinates.coordinate[k])) >= 0:
            if model.jnt_actfrclimited[k]:
                limits = coordinates.factor[k] * model.jnt_actfrcrange[k]
            else:
                limits = [-np.inf, np.inf]
            out[j] += np.sort(limits)
            is_driven[j] = True
    return np.where(is_driven[:, None] & np.isfinite(out), out, np.nan)


def _with_follower_ranges(tree: Tree) -> Tree:
    """Intersect the ranges of leaders with those of the joints that follow them."""
    all_joints = tree.all_joints
    if all_joints is None:
        return tree
    full, bounds, limited = all_joints.tree, np.array(tree.range, float), list(tree.limited)
    for k, j in enumerate(all_joints.leader):
        if full.limited[k] and k != all_joints.own[j]:
            leader_range = np.sort(
                (np.asarray(full.range)[k] - all_joints.offset[k]) / all_joints.factor[k]
            )
            if limited[j]:
                bounds[j] = [max(bounds[j, 0], leader_range[0]), min(bounds[j, 1], leader_range[1])]
            else:
                bounds[j] = leader_range
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
