"""Candidates of a search: an effect at a joint, with its entries of the flat vector."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from adaptsim_jax.attribution.parameters import (
    BODY_MASS,
    INERTIA,
    TILT,
    Entry,
    Vector,
    body_mass_entries,
    inertia_entries,
)
from adaptsim_jax.attribution.problem import Group, TreeProblem, off_value
from adaptsim_jax.effects.base import Effect, Reach, unit_at
from adaptsim_jax.effects.joints.catalogue import TILTS
from adaptsim_jax.effects.joints.forces import ARMATURE


@dataclass(frozen=True)
class JointCandidate:
    """An effect at some joints; sharing: `joint`, `all` (own values at each) or `common` (one
    value); shape: fixed shapes by joint's number and parameter, where scored.
    """

    effect: str
    joints: tuple[int, ...]
    sharing: str
    entries: tuple[Entry, ...]
    shape: tuple[tuple[str, float], ...] = ()

    @property
    def key(self) -> tuple[str, tuple[int, ...], str]:
        return self.effect, self.joints, self.sharing

    def shaped(self) -> dict[str, float]:
        return dict(self.shape)

    def at(self, entries: Sequence[Entry]) -> "JointCandidate":
        """With some of its entries, at their joints alone."""
        joints = tuple(dict.fromkeys(j for e in entries for j in e.joints))
        return replace(
            self,
            joints=joints,
            entries=tuple(entries),
            sharing="joint" if len(joints) == 1 else self.sharing,
        )

    def split(self) -> "list[JointCandidate]":
        """One a joint, where it has own values at each of several."""
        if self.sharing != "all":
            return [self]
        return [self.at([e for e in self.entries if e.joints == (j,)]) for j in self.joints]


@dataclass(frozen=True)
class CandidateScore:
    """Of a candidate at the best of its shapes: first-order fall of the held-out loss, robust p of
    the best of them; scatter: cluster-robust standard error of its only amplitude, 0 where it has
    several; points: how many shapes were scored.
    """

    candidate: JointCandidate
    held_out: float
    p: float
    scatter: float = 0.0
    points: int = 1


def entries_of(
    problem: TreeProblem, reach: Reach, effect: Effect, joints: Sequence[int], shared: bool
) -> tuple[Entry, ...]:
    """Amplitude entries of an effect at joints."""
    out = []
    for p in effect.amplitudes:
        for j in [tuple(joints)] if shared else [(j,) for j in joints]:
            ends = [p.bounds(float(reach.torque[k]), float(reach.speed[k])) for k in j]
            start = off_value(problem, effect.name, p.name, j[0])
            low, high = min(e[0] for e in ends), max(e[1] for e in ends)
            low = 0.0 if p.sign > 0 else low
            prior = p.prior * max(e[1] for e in ends) / p.high
            unit = unit_at(p.unit, problem.kinds[j[0]])
            out.append(
                Entry(
                    effect.name, p.name, j, start, start, min(low, start), high + start, unit, prior
                )
            )
    return tuple(out)


def shape_entries(
    problem: TreeProblem, reach: Reach, candidate: JointCandidate
) -> tuple[Entry, ...]:
    """Entries of the shapes that are fitted once an effect is in the model, at the values it was
    scored with.
    """
    effect, given = problem.effect(candidate.effect), candidate.shaped()
    out = []
    for p in effect.shapes:
        if p.held and p.name not in given:
            continue
        for j in (
            [candidate.joints]
            if candidate.sharing == "common"
            else [(j,) for j in candidate.joints]
        ):
            low, high = p.bounds(float(reach.torque[j[0]]), float(reach.speed[j[0]]))
            value = given.get(p.name, p.default)
            if p.held:
                low = high = value
            elif p.name == "angle":
                span = float(reach.q_high[j[0]] - reach.q_low[j[0]])
                low, high = value - 0.2 * span, value + 0.2 * span
            else:
                low, high = (
                    max(low, value / 3.0 if value > 0 else low),
                    min(high, value * 3.0 if value > 0 else high),
                )
            out.append(
                Entry(
                    effect.name,
                    p.name,
                    j,
                    value,
                    value,
                    low,
                    high,
                    unit_at(p.unit, problem.kinds[j[0]]),
                    prior=np.inf,
                )
            )
    return tuple(out)


def candidates(problem: TreeProblem, vector: Vector, reach: Reach) -> list[JointCandidate]:
    """All that may be added to the vector: each effect at each joint, at all of them, with one
    value for all; a tilted base.
    """
    taken = {(e.owner, j) for e in vector.entries for j in e.joints}
    out = []
    for effect in problem.effects:
        free = _free_joints(problem, effect, taken)
        if effect.place == "model":
            out += _of_model(problem, effect.name, taken)
            continue
        follows = any(np.any(g.actuator[2] != 0.0) for g in problem.groups)
        if effect.traits.of_controller and not follows:
            continue
        grids = [(j, effect.grid_points(reach, j)) for j in free]
        if effect.place == "drive":
            grids = _of_drives(problem, grids, follows, taken)
        out += _of_effect(problem, reach, effect, free, grids)
    return out


def _of_effect(
    problem: TreeProblem, reach: Reach, effect: Effect, free: Sequence[int], grids: Sequence[tuple]
) -> list[JointCandidate]:
    """An effect at each joint of the grids, at all free joints, and with one value for these."""

    def make(joints, sharing, shape=()):
        entries = entries_of(problem, reach, effect, joints, sharing == "common")
        return JointCandidate(effect.name, tuple(joints), sharing, entries, shape)

    out = [
        make([j], "joint", _fixed(point))
        for j, points in grids
        if j not in problem.unlike
        for point in points
    ]
    if len(free) < 2:
        return out
    if effect.traits.family and not effect.shapes:
        out.append(make(free, "all"))
    if effect.traits.shared:
        out += [make(free, "common", _fixed(point)) for point in grids[0][1]]
    return out


def _of_drives(problem: TreeProblem, grids: Sequence[tuple], follows: bool, taken: set) -> list:
    """Joints that have rotors, each with its points of an effect of the drive. Without a position
    controller it does not matter on which side that one's encoder is.
    """
    out = []
    for j, points in grids:
        declared = off_value(problem, ARMATURE.name, "inertia", j)
        if declared > 0.0 or (ARMATURE.name, j) in taken:
            out.append((j, [z for z in points if follows or z["link"] == z["control"]]))
    return out


def _free_joints(problem: TreeProblem, effect: Effect, taken: set[tuple[str, int]]) -> list[int]:
    """Joints at which an effect is not fitted and can act."""
    driven = [j for j in range(problem.joints) if problem.reach.peak[j] > 0.0]
    first = {g.joints[0] for g in problem.groups}
    out = []
    for j in range(problem.joints):
        free = (effect.name, j) not in taken and (effect.name, j) not in problem.excluded
        like = j not in problem.unlike or effect.traits.shared
        moved = j in driven or not effect.on_actuator
        if free and like and moved and not (effect.pair and j in first):
            out.append(j)
    return out


def _of_model(problem: TreeProblem, name: str, taken: set[tuple[str, int]]) -> list[JointCandidate]:
    """What frees parameters of the model itself: the direction of gravity, where there is any. The
    inertia of a body with a mass.
    """
    if name == BODY_MASS:
        return []
    if name == INERTIA:
        bodies = [
            j for g in problem.groups for at, j in enumerate(g.joints) if g.inertias.massive[at]
        ]

        def own(j):
            return inertia_entries(np.arange(j + 1) == j)

        return [
            JointCandidate(INERTIA, (j,), "joint", own(j))
            for j in bodies
            if (INERTIA, j) not in taken | problem.excluded and j not in problem.unlike
        ]
    weightless = not any(np.any(np.asarray(g.model.tree.gravity)) for g in problem.groups)
    if weightless or (TILT, 0) in taken:
        return []
    everywhere = tuple(range(problem.joints))
    entries = tuple(
        Entry(TILT, t, everywhere, 0.0, 0.0, -0.5, 0.5, "rad", prior=1.0) for t in TILTS
    )
    return [JointCandidate(TILT, everywhere, "common", entries)]


def body_mass_candidates(group: Group) -> list[JointCandidate]:
    """Each body of a group that has a mass, with another one."""
    return [
        JointCandidate(
            BODY_MASS,
            (j,),
            "joint",
            tuple(replace(e, joints=(j,)) for e in body_mass_entries(group.model.tree, k)),
        )
        for k, j in enumerate(group.joints)
        if group.inertias.massive[k]
    ]


def _fixed(point) -> tuple[tuple[str, float], ...]:
    return tuple(sorted((k, float(z)) for k, z in point.items()))


def adjacent(problem: TreeProblem, c: JointCandidate, other: JointCandidate) -> bool:
    """Whether two effects act at the same joint or at a joint and its parent, where one may stand
    in for the other.
    """
    parents = problem.parents

    def near(j: int, k: int) -> bool:
        return j == k or parents[j] == k or parents[k] == j

    return any(near(j, k) for j in c.joints for k in other.joints)


def where(problem: TreeProblem, c: JointCandidate) -> str:
    if c.effect == TILT:
        return "base"
    return ", ".join(problem.joint_names[j] for j in c.joints)
