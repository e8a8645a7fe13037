"""What a motion of a machine may do by its model file: angles, speeds and torques within limits, no
body on another. MuJoCo has the last word: its inverse dynamics for torques, its collisions for
contact.
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from xml.etree import ElementTree

import mujoco
import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.mechanisms.mjcf import Mechanism, mechanism_of
from adaptsim_jax.mechanisms.roles import FREE, pose_of
from adaptsim_jax.mechanisms.spec import Source, compiled, read_source, read_spec, shapeless


@dataclass(frozen=True)
class Margins:
    """What a motion keeps from the limits of a file, and what stands for limits that it has not."""

    # of a joint's range, from each end: controllers overshoot, stops are set by hand
    range: float = 0.05
    # of a torque limit, that is used: friction, a payload and the controller's share come on top
    torque: float = 0.7
    # of a speed limit, that is used: a drive's torque falls towards it
    speed: float = 0.7
    # m, between bodies: shapes are simplified, mounts a little off
    clearance: float = 0.01
    # rad, m either way from home, of a joint without a range: cables
    turn: float = 1.5
    slide: float = 0.1
    # rad/s, m/s, of a joint without a speed limit: a person can still stop it
    turning: float = 2.0
    sliding: float = 0.25
    # m, radius of a capsule in the place of a body whose shapes are not at hand
    stand_in: float = 0.03


MARGINS = Margins()
MOST_NAMED = 4
Pair = tuple[int, int]


@dataclass(frozen=True)
class Coordinate:
    """A joint of the file that moves: where it is in qpos and qvel, and the coordinate that it goes
    with, at offset + factor * q.
    """

    qpos: int
    dof: int
    joint: int
    factor: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Bodies:
    """A machine in MuJoCo: `model` for torques, where nothing touches; `solid` for contacts; all
    else than `coordinates` at `pose [nq]`; `min_gap`: gap, m, of pairs of bodies which are nearer
    at home.
    """

    model: mujoco.MjModel
    solid: mujoco.MjModel
    pose: np.ndarray
    coordinates: tuple[Coordinate, ...]
    clearance: float
    min_gap: Mapping[Pair, float] = field(default_factory=dict)

    def torques(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Compute the joints' forces [T, n], N m or N, along a motion: inverse dynamics."""
        data, out = mujoco.MjData(self.model), np.zeros_like(q)
        for t in range(len(q)):
            self._place(data, q[t])
            for c in self.coordinates:
                data.qvel[c.dof] = c.factor * v[t, c.joint]
                data.qacc[c.dof] = c.factor * a[t, c.joint]
            mujoco.mj_inverse(self.model, data)
            for c in self.coordinates:
                out[t, c.joint] += c.factor * data.qfrc_inverse[c.dof]
        return out

    def touching(self, q: np.ndarray) -> tuple[int, str, str] | None:
        """Return the first row of a motion [T, n] in which two bodies come too near, and these."""
        data = mujoco.MjData(self.solid)
        for t, row in enumerate(q):
            for pair, gap in self.near_gaps(row, data).items():
                if gap < self.min_gap.get(pair, self.clearance):
                    one, other = (self.solid.body(b).name for b in pair)
                    return t, one, other
        return None

    def near_gaps(self, q: np.ndarray, data: mujoco.MjData | None = None) -> dict[Pair, float]:
        """Measure the gaps below the clearance, m, by pair of bodies. Bodies that a joint connects
        and what the file excludes are no pairs, as MuJoCo has it.
        """
        data = mujoco.MjData(self.solid) if data is None else data
        self._place(data, q)
        mujoco.mj_kinematics(self.solid, data)
        mujoco.mj_comPos(self.solid, data)
        mujoco.mj_collision(self.solid, data)
        out: dict[Pair, float] = {}
        for c in data.contact[: data.ncon]:
            one, other = sorted(int(self.solid.geom_bodyid[g]) for g in (c.geom1, c.geom2))
            out[one, other] = min(float(c.dist), out.get((one, other), np.inf))
        return out

    def _place(self, data: mujoco.MjData, q: np.ndarray) -> None:
        data.qpos[:] = self.pose
        for c in self.coordinates:
            data.qpos[c.qpos] = c.offset + c.factor * q[c.joint]


@dataclass(frozen=True)
class Allowed:
    """Of n driven joints `home`, and limits less their margins, [n]: `low`, `high` rad (m), `speed`
    rad/s (m/s), `torque` N m (N). notes: what was assumed or left out, a sentence each.
    """

    mechanism: Mechanism
    bodies: Bodies
    home: np.ndarray
    low: np.ndarray
    high: np.ndarray
    speed: np.ndarray
    torque: np.ndarray
    notes: tuple[str, ...]


def allowed(path: str | os.PathLike, margins: Margins = MARGINS) -> Allowed:
    """What the joints of a file may do: those that an actuator drives, or all where it has none.

    Raises BadInput where its base moves.

    Args:
        path: MJCF or URDF file.
        margins: What is kept from its limits.
    """
    source = read_source(path)
    model = source.model
    for k in range(model.njnt):
        if model.jnt_type[k] == FREE:
            raise BadInput(
                f"{path}: the base moves freely (joint {model.joint(k).name}), so that no motion "
                "of the joints is its own; hang it up, and give a file without that joint"
            )
    mechanism = _driven(source)
    notes = [note for note in mechanism.notes if note.startswith("held")]
    pose, coordinates = _coordinates(source, mechanism)
    solid = _solid(str(path), margins, notes)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_EQUALITY
    bodies = Bodies(model, solid, pose, coordinates, margins.clearance)
    first = {c.joint: c for c in reversed(coordinates)}
    home = np.array([(pose[c.qpos] - c.offset) / c.factor for _, c in sorted(first.items())])
    low, high = _ranges(mechanism, home, margins, notes)
    home = np.clip(home, low, high)
    speed = margins.speed * _speeds(source, mechanism, margins, notes)
    torque = margins.torque * _limits(mechanism, model, coordinates, notes)
    near_gaps = bodies.near_gaps(home)
    min_gap = {pair: 0.0 if gap > 0.0 else -np.inf for pair, gap in near_gaps.items()}
    if near_gaps:
        pairs = first_names(["-".join(solid.body(b).name for b in pair) for pair in near_gaps])
        notes.append(f"touch or nearly so at home, and may go on to: {pairs}")
    bodies = replace(bodies, min_gap=min_gap)
    return Allowed(mechanism, bodies, home, low, high, speed, torque, tuple(notes))


def _driven(source: Source) -> Mechanism:
    """The tree of the joints that actuators drive, all others held at home; whole without any."""
    full = mechanism_of(source)
    joints = {source.model.joint(k).name for k in range(source.model.njnt)}
    names = {full.tree.joint_names[a.joint] for a in full.actuators} & joints
    return mechanism_of(source, logged=names) if names else full


def _coordinates(source: Source, m: Mechanism) -> tuple[np.ndarray, tuple[Coordinate, ...]]:
    """Return the pose of held joints [nq], and the joints that move, leaders first."""
    model, names, roles = source.model, m.tree.joint_names, m.roles
    assert roles is not None
    pose, leaders, followers = pose_of(model)[0].copy(), [], []
    for k in range(model.njnt):
        name = model.joint(k).name
        at, dof = int(model.jnt_qposadr[k]), int(model.jnt_dofadr[k])
        if name in names:
            leaders.append(Coordinate(at, dof, names.index(name)))
        elif name in roles.followers:
            f = roles.followers[name]
            followers.append(Coordinate(at, dof, names.index(f.leader), f.factor, f.offset))
        elif name in roles.held:
            value = np.atleast_1d(roles.held[name])
            pose[at : at + len(value)] = value
    return pose, (*leaders, *followers)


def _ranges(
    m: Mechanism, home: np.ndarray, margins: Margins, notes: list[str]
) -> tuple[np.ndarray, np.ndarray]:
    tree = m.tree
    turns, limited = np.array([k == "hinge" for k in tree.kinds]), np.array(tree.limited)
    default_range = np.where(turns, margins.turn, margins.slide)
    low, high = np.where(
        limited[:, None], tree.range, np.stack([home - default_range, home + default_range], 1)
    ).T
    if not limited.all():
        _note_missing(
            notes, "range", ~limited, m, f"{margins.turn} rad or {margins.slide} m from home"
        )
    margin = np.where(limited, margins.range * (high - low), 0.0)
    return low + margin, high - margin


def _speeds(source: Source, m: Mechanism, margins: Margins, notes: list[str]) -> np.ndarray:
    """Speed limits [n]; MJCF has none."""
    declared_speeds: dict[str, float] = {}
    if source.kind == "urdf":
        for joint in ElementTree.parse(source.path).getroot().iter("joint"):
            limit = joint.find("limit")
            if limit is not None and float(limit.get("velocity", 0)) > 0.0:
                declared_speeds[joint.get("name", "")] = float(limit.get("velocity", 0))
    names, kinds = m.tree.joint_names, m.tree.kinds
    default_speeds = {"hinge": margins.turning, "slide": margins.sliding}
    is_missing = np.array([name not in declared_speeds for name in names])
    if is_missing.any():
        _note_missing(
            notes, "speed limit", is_missing, m, f"{margins.turning} rad/s, {margins.sliding} m/s"
        )
    return np.array(
        [declared_speeds.get(n, default_speeds[k]) for n, k in zip(names, kinds, strict=True)]
    )


def _limits(m: Mechanism, model: mujoco.MjModel, coordinates, notes: list[str]) -> np.ndarray:
    """Torque limits [n]: of actuators together, and of the joints."""
    n = m.tree.n
    limits = np.zeros(n)
    for a in m.actuators:
        limit = np.abs(a.forcerange).min()
        if a.kp == 0.0 and a.kv == 0.0:
            limit = np.fmin(limit, abs(a.gain) * np.abs(a.ctrlrange).min())
        limits[a.joint] += abs(a.gear) * limit
    limits[limits == 0.0] = np.nan
    for c in coordinates:
        k = int(model.dof_jntid[c.dof])
        if model.jnt_actfrclimited[k] and c.factor == 1.0:
            limits[c.joint] = np.fmin(limits[c.joint], np.abs(model.jnt_actfrcrange[k]).min())
    if (is_missing := np.isnan(limits)).any():
        _note_missing(notes, "torque limit", is_missing, m, "none")
    return np.where(is_missing, np.inf, limits)


def _note_missing(
    notes: list[str], quantity: str, is_missing: np.ndarray, m: Mechanism, default: str
) -> None:
    names = first_names([m.tree.joint_names[j] for j in np.flatnonzero(is_missing)])
    notes.append(f"the file has no {quantity} of {names}: {default} is taken")


def first_names(names: Sequence[str]) -> str:
    """The first of some names, and how many more there are."""
    rest = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
    return ", ".join(names[:MOST_NAMED]) + rest


def _solid(path: str, margins: Margins, notes: list[str]) -> mujoco.MjModel:
    """The model for contacts. Bodies without shapes get capsules to their children, and a file
    without surroundings a floor.
    """
    spec, _ = read_spec(path)
    try:
        model = compiled(path, spec)
    except BadInput:
        model = shapeless(path, spec)
    is_solid = (model.geom_contype | model.geom_conaffinity) > 0
    solid_bodies = {int(b) for b in model.geom_bodyid[is_solid]}
    shapeless_bodies = [b for b in range(1, model.nbody) if b not in solid_bodies]
    for b in shapeless_bodies:
        ends = [model.body_pos[c] for c in np.flatnonzero(model.body_parentid == b)]
        ends = [
            z for z in ends or [2.0 * model.body_ipos[b]] if np.linalg.norm(z) > margins.stand_in
        ]
        for end in ends:
            spec.body(model.body(b).name).add_geom(
                type=mujoco.mjtGeom.mjGEOM_CAPSULE,
                fromto=[0, 0, 0, *end],
                size=[margins.stand_in, 0, 0],
                mass=0,
            )
    if shapeless_bodies:
        names = first_names([model.body(b).name for b in shapeless_bodies])
        notes.append(f"no shape that collides is at hand of {names}: capsules stand for them")
    if 0 not in solid_bodies:
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 0.1])
        notes.append("the file has no surroundings: a floor at z = 0 is taken")
    solid = compiled(path, spec)
    solid.geom_margin[:] = margins.clearance
    return solid
