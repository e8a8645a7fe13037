"""One identification problem: joints in groups that share no moving body, their stretches, and the
values of a parameter vector.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import jax
import numpy as np

from adaptsim_jax.attribution.acting import ActingModel, Values
from adaptsim_jax.attribution.criteria import CHOICE, RANGE, STRETCH
from adaptsim_jax.attribution.parameters import (
    BODY_NUMBERS,
    OF_BODIES,
    TILT,
    Entry,
    Inertias,
    Vector,
    inertia_entries,
    inertias,
)
from adaptsim_jax.attribution.stretches import JointStretches, JointTrack, cut, without_first_rows
from adaptsim_jax.diagnosis.folds import folds_of, names_of
from adaptsim_jax.effects.base import Effect, Reach, unit_at
from adaptsim_jax.effects.joints.actuator import DEAD_ZONE, SATURATION, TORQUE_GAIN
from adaptsim_jax.effects.joints.catalogue import TILTS
from adaptsim_jax.effects.joints.forces import ARMATURE, SPRING
from adaptsim_jax.effects.joints.friction import COULOMB, LOAD_FRICTION, QUADRATIC_DRAG, VISCOUS
from adaptsim_jax.logs.noise import local_motion, sensor_noise
from adaptsim_jax.mechanisms import equations
from adaptsim_jax.mechanisms.tree import Tree, subtrees, take

LANE_MULTIPLE = 16  # stretches are padded to a multiple, so that compiled programs repeat


@dataclass(frozen=True)
class Group:
    """Joints that share no moving body with the others. joints: their numbers in the whole
    mechanism; folds [W].
    """

    model: ActingModel
    joints: tuple[int, ...]
    stretches: JointStretches
    actuator: np.ndarray  # [6, n]
    gear: np.ndarray  # [n]
    inertias: Inertias
    ties: np.ndarray | None = None  # [n, n]


@dataclass(frozen=True)
class TreeProblem:
    """A recording ready to be fitted. reach: what it covers, by joint; fold [W] of each stretch,
    the same in all groups.
    """

    groups: tuple[Group, ...]
    joint_names: tuple[str, ...]
    kinds: tuple[str, ...]
    effects: tuple[Effect, ...]
    reach: Reach
    fold: np.ndarray
    folds: tuple[str, ...]
    declared: dict[
        tuple[str, str], np.ndarray
    ]  # (effect, parameter) -> [n] what the model file says
    floor: np.ndarray  # [2n] noise of angles and speeds
    least: np.ndarray | float = 0.0  # [n] error of angles below which no effect is worth a name
    unlike: tuple[
        int, ...
    ] = ()  # joints that are not as the model says in another way, where nothing is named
    excluded: frozenset[tuple[str, int]] = frozenset()  # effects and joints that no search asks for
    # (effect, parameter) -> lower and upper end [2, n] that leave most of the rows
    most: dict[tuple[str, str], np.ndarray] = field(default_factory=dict)

    @property
    def joints(self) -> int:
        return len(self.joint_names)

    @property
    def units(self) -> tuple[str, ...]:
        """[n] of the joints' coordinates."""
        return tuple("rad" if kind == "hinge" else "m" for kind in self.kinds)

    @property
    def force_units(self) -> tuple[str, ...]:
        """[n] of what acts on the joints."""
        return tuple("N m" if kind == "hinge" else "N" for kind in self.kinds)

    @property
    def parents(self) -> tuple[int, ...]:
        """[n] The joint before each in the tree, -1 for none."""
        out = [-1] * self.joints
        for group in self.groups:
            for joint, parent in zip(group.joints, group.model.tree.parent, strict=True):
                if parent >= 0:
                    out[joint] = group.joints[parent]
        return tuple(out)

    def effect(self, name: str) -> Effect:
        return next(e for e in self.effects if e.name == name)

    def offers(self, name: str) -> bool:
        """Whether an effect is in the catalogue that is searched."""
        return any(e.name == name for e in self.effects)


def prepare(
    tree: Tree,
    tracks: Sequence[JointTrack],
    effects: Sequence[Effect],
    actuator: np.ndarray | None = None,
    gear: np.ndarray | None = None,
    horizon: float = CHOICE.horizon,
    most: int = STRETCH.max_count,
    declared: Mapping[tuple[str, str], np.ndarray] | None = None,
    look_back: float = 0.0,
    ties: np.ndarray | None = None,
) -> TreeProblem:
    """Cut and grouped. actuator [6, n]: gain, bias, per angle, per speed, lowest and highest force
    (None: torques); gear [n]; look_back: s from each stretch's start whose readings do not count;
    ties [n, n]: see `acting.Values`.
    """
    n = len(tree.joint_names)
    # sharp, as of real joints (`equation/rubbing.py`)
    tree = replace(within_reach(tree, tracks), friction_softness=np.zeros((n, 2)))
    stretches = without_first_rows(cut(tracks, horizon, most), look_back)
    fold = folds_of(stretches.trial)
    names = names_of(stretches.trial, fold, stretches.names)
    stretches = _padded(stretches)
    if actuator is None:
        limit = np.full(n, np.inf)
        actuator = np.stack([np.ones(n), *[np.zeros(n)] * 3, -limit, limit])
    gear = np.ones(n) if gear is None else np.asarray(gear, float)
    groups = []
    for joints in tied(subtrees(tree), ties):
        part, some = _nameless(take(tree, joints)), list(joints)
        own = None if ties is None else ties[np.ix_(joints, joints)]
        if own is not None and not np.any(own):
            own = None
        groups.append(
            Group(
                ActingModel(part, tuple(effects)),
                tuple(joints),
                stretches.of(joints),
                np.asarray(actuator)[..., some],
                gear[..., some],
                inertias(np.asarray(part.inertial)),
                own,
            )
        )
    as_declared = numbers_of(tree)
    as_declared |= dict(declared or {})
    return TreeProblem(
        tuple(groups),
        tuple(tree.joint_names),
        tuple(tree.kinds),
        tuple(effects),
        _reach(tracks, actuator, gear, ties),
        fold,
        names,
        as_declared,
        noise(tracks),
        most=passing(tracks, actuator, gear, ties),
    )


def numbers_of(tree: Tree) -> dict[tuple[str, str], np.ndarray]:
    """What a model file says of effects, (effect, parameter) -> [n]."""
    stiffness = np.asarray(tree.stiffness)
    return {
        (VISCOUS.name, "damping"): np.asarray(tree.damping),
        (QUADRATIC_DRAG.name, "drag"): np.asarray(tree.damping_poly)[:, 0],
        (COULOMB.name, "level"): np.asarray(tree.frictionloss),
        (ARMATURE.name, "inertia"): np.asarray(tree.armature),
        (SPRING.name, "stiffness"): stiffness,
        (SPRING.name, "preload"): stiffness * np.asarray(tree.springref),
    }


def beyond_range(tree: Tree, tracks: Sequence[JointTrack]) -> np.ndarray:
    """How far [n] the motion goes beyond the declared ranges, at its 99th percentile; -inf for
    joints without.
    """
    low, high = np.asarray(tree.range, float).T
    q = np.concatenate([t.q for t in tracks])
    excess = np.maximum(
        np.nanquantile(q, 0.99, axis=0) - high, low - np.nanquantile(q, 0.01, axis=0)
    )
    return np.where(tree.limited, excess, -np.inf)


def within_reach(tree: Tree, tracks: Sequence[JointTrack]) -> Tree:
    """The same where only those limits count that the motion may feel: not those that it stays away
    from, nor those that it goes far beyond, which the machine cannot have.
    """
    excess = beyond_range(tree, tracks)
    q = np.concatenate([t.q for t in tracks])
    low, high = np.asarray(tree.range, float).T
    near = np.maximum(np.nanmax(q, axis=0) - high, low - np.nanmin(q, axis=0)) > -RANGE.near_stop
    return replace(
        tree,
        limited=tuple(
            bool(a and b and c <= RANGE.beyond_stop)
            for a, b, c in zip(tree.limited, near, excess, strict=True)
        ),
    )


def tied(groups: list[tuple[int, ...]], ties: np.ndarray | None) -> list[tuple[int, ...]]:
    """Groups of joints, those put together that an actuator ties to each other."""
    if ties is None:
        return groups
    for i, j in np.argwhere(ties):
        one, two = (next(g for g in groups if k in g) for k in (i, j))
        if one != two:
            groups = sorted([*(g for g in groups if g not in (one, two)), tuple(sorted(one + two))])
    return groups


def beginnings(problem: TreeProblem, share: float) -> TreeProblem:
    """The same of which only the first share of each stretch was seen."""

    def begun(g: Group) -> Group:
        s, mask, mask_v = g.stretches, g.stretches.seen.copy(), g.stretches.seen_v.copy()
        last = max(2, round(share * s.rows))
        mask[last + 1 :] = mask_v[last + 1 :] = 0
        return replace(g, stretches=replace(s, seen=mask, seen_v=mask_v))

    return replace(problem, groups=tuple(begun(g) for g in problem.groups))


def _nameless(tree: Tree) -> Tree:
    """The same with names that say nothing, so that four like legs share one compiled program."""
    count = range(len(tree.joint_names))
    if tree.all_joints is None:
        all_joints = None
    else:
        all_joints = replace(tree.all_joints, tree=_nameless(tree.all_joints.tree))
    return replace(
        tree,
        joint_names=tuple(f"j{k}" for k in count),
        body_names=tuple(f"b{k}" for k in count),
        all_joints=all_joints,
    )


def _padded(stretches: JointStretches) -> JointStretches:
    """The last stretch again, unseen, until there is a multiple of `LANE_MULTIPLE`."""
    short = -stretches.count % LANE_MULTIPLE
    if not short:
        return stretches
    wide = stretches.pick(
        np.concatenate([np.arange(stretches.count), np.full(short, stretches.count - 1)])
    )
    wide.seen[..., -short:] = 0
    wide.seen_v[..., -short:] = 0
    return wide


def noise(tracks: Sequence[JointTrack]) -> np.ndarray:
    """Sensor noise [2n] of angles and speeds, from what local cubics leave (a robust standard
    deviation); 0 where not logged.
    """
    n = tracks[0].q.shape[1]
    out = np.zeros(2 * n)
    for k, pick in enumerate((lambda t: t.q, lambda t: t.v)):
        parts = [sensor_noise([pick(t)]) for t in tracks if pick(t) is not None]
        if parts:
            out[k * n : (k + 1) * n] = np.median(np.array(parts), 0)
    return out


def held(actuator: np.ndarray) -> np.ndarray:
    """Which joints [n] a controller of their actuators [6, n] holds: told where to be, or how fast
    to go.
    """
    gain, _, per_q, per_v, _, _ = np.asarray(actuator)
    return (per_q != 0.0) | ((per_v != 0.0) & (gain != 0.0))


def drive_force(
    actuator: np.ndarray, gear: np.ndarray, ties: np.ndarray | None, q, v, u
) -> np.ndarray:
    """Forces [T, n] of the declared actuators on the joints, at q, v [T, n] under u [T, n]."""
    gain, bias, per_q, per_v, lowest, most = actuator
    moment = np.diag(gear) + (0.0 if ties is None else ties)
    force = np.clip(gain * u + bias + per_q * (q @ moment.T) + per_v * (v @ moment.T), lowest, most)
    return force @ moment


def _reach(
    tracks: Sequence[JointTrack],
    actuator: np.ndarray,
    gear: np.ndarray,
    ties: np.ndarray | None = None,
) -> Reach:
    torque, peak, speed, low, high = [], [], [], [], []
    for track in tracks:
        u, v = _driven(track, actuator, gear, ties)
        q, _ = local_motion(track.time, track.q, track.v)
        torque.append(np.quantile(np.abs(u), 0.998, axis=0))
        peak.append(np.abs(u).max(0))
        speed.append(np.quantile(np.abs(v), 0.9, axis=0))
        low.append(np.quantile(q, 0.005, axis=0))
        high.append(np.quantile(q, 0.995, axis=0))
    torque = np.max(torque, 0)
    longest = max(t.span for t in tracks)
    # the longest: a shift that the slowest trial does not resolve is not named
    dt = max(t.dt for t in tracks)
    speed = np.maximum(np.max(speed, 0), 0.02)
    return Reach(
        torque,
        np.max(peak, 0),
        speed,
        np.min(low, 0),
        np.max(high, 0),
        longest,
        dt,
        np.ones(len(torque)),
    )


def moving(problem: TreeProblem) -> np.ndarray:
    """Which joints [n] move in the log."""
    span = problem.reach.q_high - problem.reach.q_low
    return span > RANGE.moving_noises * problem.floor[: problem.joints]


def passing(
    tracks: Sequence[JointTrack],
    actuator: np.ndarray,
    gear: np.ndarray,
    ties: np.ndarray | None = None,
) -> dict[tuple[str, str], np.ndarray]:
    """Ends of ranges [2, n] of what an actuator does otherwise: a limit cuts at most half of the
    rows, a dead zone swallows at most a quarter, a gain leaves between half and twice the torque.

    What cuts off nearly all rows makes both sides of a balance vanish, and would explain anything.
    """
    size = np.abs(np.concatenate([_driven(t, actuator, gear, ties)[0] for t in tracks]))
    peak, limit, zone = size.max(0), np.median(size, 0), np.quantile(size, 0.25, axis=0)
    cut = 1.0 - limit / np.where(peak > 0.0, peak, 1.0)
    lowest, half = np.full_like(cut, -np.inf), np.full_like(cut, 0.5)
    return {
        (SATURATION.name, "cut"): np.stack([lowest, cut]),
        (DEAD_ZONE.name, "width"): np.stack([lowest, zone]),
        (LOAD_FRICTION.name, "share"): np.stack([lowest, half]),
        (TORQUE_GAIN.name, "gain"): np.stack([-half, 2.0 * half]),
    }


def _driven(track: JointTrack, actuator: np.ndarray, gear: np.ndarray, ties: np.ndarray | None):
    """Forces of the declared actuators [T, n] along a track, and its speeds [T, n]."""
    q, v = local_motion(track.time, track.q, track.v)
    return drive_force(actuator, gear, ties, q, v, np.nan_to_num(track.u)), v


def scaled_reach(problem: TreeProblem, inertia: np.ndarray, gravity: np.ndarray) -> Reach:
    """The reach with torque scales [n] that are not zero where a joint has no actuator: those of
    its own motion and weight.
    """
    r = problem.reach
    span = 0.5 * (r.q_high - r.q_low) + 1e-3
    own = np.maximum(gravity, inertia * r.speed**2 / span)
    torque = np.maximum(r.torque, 0.5 * own)
    return Reach(
        torque, np.maximum(r.peak, 1e-9), r.speed, r.q_low, r.q_high, r.duration, r.dt, inertia
    )


def nuisances(problem: TreeProblem, inertia: bool = True, damping: bool = True) -> Vector:
    """The vector of the declared model: inertial parameters of all bodies, and viscous friction at
    every joint.
    """
    entries: list[Entry] = []
    if inertia:
        for g in problem.groups:
            local = inertia_entries(g.inertias.massive)
            entries += [Entry(**{**e.__dict__, "joints": (g.joints[e.joints[0]],)}) for e in local]
    if damping:
        start = problem.declared[VISCOUS.name, "damping"]
        # of a joint that nothing drives, what its own weight and motion are worth
        reach = scaled_reach(problem, *own_inertia(problem, Vector((), np.zeros(0))))
        top = 5.0 * reach.torque / reach.speed + 10.0 * start
        entries += [
            Entry(
                VISCOUS.name,
                "damping",
                (j,),
                float(start[j]),
                0.0,
                0.0,
                float(top[j]),
                unit_at("N m s/rad", problem.kinds[j]),
            )
            for j in range(problem.joints)
        ]
    vector = Vector(tuple(entries), np.array([e.start for e in entries]))
    return vector


def off_value(problem: TreeProblem, effect: str, parameter: str, joint: int) -> float:
    """What the declared model has of a parameter: what its file says, or none of it."""
    given = problem.declared.get((effect, parameter))
    if given is not None:
        return float(given[joint])
    return next(p.default for p in problem.effect(effect).parameters if p.name == parameter)


def values_of(
    problem: TreeProblem, group: Group, vector: Vector, rows: np.ndarray | None = None
) -> Values:
    """Values of a group at `vector`; rows [W, P]: other values for each stretch."""
    n, width = len(group.joints), 1 if rows is None else len(rows)
    numbers = vector.values[None] if rows is None else np.asarray(rows)
    place = {j: k for k, j in enumerate(group.joints)}
    bodies = np.zeros((width, n, len(BODY_NUMBERS)))
    effects: dict[str, dict[str, np.ndarray]] = {}
    for e in problem.effects:
        if e.place == "model":
            continue
        effects[e.name] = {}
        for p in e.parameters:
            off = [[off_value(problem, e.name, p.name, j)] for j in group.joints]
            effects[e.name][p.name] = np.repeat(off, width, 1)
    tilt = np.zeros((width, 2))
    for i, e in enumerate(vector.entries):
        for j in e.joints:
            if e.owner == TILT:
                tilt[:, TILTS.index(e.name)] = numbers[:, i]
            elif j not in place:
                continue
            elif e.owner in OF_BODIES:
                bodies[:, place[j], BODY_NUMBERS.index(e.name)] = numbers[:, i]
            else:
                effects[e.owner][e.name][place[j]] = numbers[:, i]
    which, lane = np.unique(
        bodies, axis=0, return_inverse=True
    )  # as many as there are folds, not stretches
    inertial = np.stack([group.inertias.at(z)[0] for z in which], -1)
    if len(which) != 1:
        inertial = inertial[..., lane.reshape(-1)]
    gravity = np.stack([tilted(np.asarray(group.model.tree.gravity), *z) for z in tilt], -1)

    def wide(z):
        return np.asarray(z, float)[..., None]

    ties = None if group.ties is None else wide(group.ties)
    read = group.stretches.start[:n]
    return Values(inertial, gravity, wide(group.actuator), wide(group.gear), effects, ties, read)


def tilted(gravity: np.ndarray, about_x: float, about_y: float) -> np.ndarray:
    """Gravity [3] in a base turned by small angles [rad] about the world's x and y."""
    cx, sx, cy, sy = np.cos(about_x), np.sin(about_x), np.cos(about_y), np.sin(about_y)
    turn_x = np.array([[1, 0, 0], [0, cx, sx], [0, -sx, cx]])
    turn_y = np.array([[cy, 0, -sy], [0, 1, 0], [sy, 0, cy]])
    return turn_y @ turn_x @ gravity


def own_inertia(problem: TreeProblem, vector: Vector) -> tuple[np.ndarray, np.ndarray]:
    """What each joint feels of inertia, 1 / diag(M^-1) [n], and the largest force of gravity [n],
    at middle and start angles.
    """
    inertia, weight = np.zeros(problem.joints), np.zeros(problem.joints)
    for g in problem.groups:
        inertia[list(g.joints)], weight[list(g.joints)] = group_inertia(
            values_of(problem, g, vector), g
        )
    return inertia, weight


def group_inertia(values: Values, group: Group) -> tuple[np.ndarray, np.ndarray]:
    """`own_inertia` of a group's joints at its values."""
    with jax.enable_x64(True):
        q = group.stretches.start[: len(group.joints)]
        mass, force = (
            np.asarray(z) for z in _at_rest(group.model.tree, values.inertial, values.gravity, q)
        )
    mass = np.moveaxis(mass, -1, 0)
    if ARMATURE.name in values.effects:
        arm = values.effects[ARMATURE.name]["inertia"][:, 0]
    else:
        arm = np.zeros(len(group.joints))
    inverse = np.linalg.inv(mass + np.diag(arm))
    return 1.0 / np.median(np.diagonal(inverse, axis1=1, axis2=2), 0), np.abs(force).max(1)


@jax.jit
def _at_rest(tree: Tree, inertial, gravity, q):
    return equations.mass_matrix(tree, inertial, q), equations.gravity_force(
        tree, inertial, q, gravity
    )
