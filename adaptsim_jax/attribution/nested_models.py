"""Nested models of simulated stretches, without an effect or with another in its place, and what
they show of it: evidence for the rules.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from adaptsim_jax.attribution.candidates import CandidateScore, JointCandidate, adjacent, candidates
from adaptsim_jax.attribution.estimate import fit
from adaptsim_jax.attribution.fitted import FittedTree, held_error
from adaptsim_jax.attribution.held_out import modelled, paired, refit
from adaptsim_jax.attribution.parameters import Entry, Vector
from adaptsim_jax.attribution.problem import TreeProblem
from adaptsim_jax.attribution.score import table
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.rules import Evidence
from adaptsim_jax.diagnosis.testing import Test, attainable, jackknife
from adaptsim_jax.effects.base import Effect, Reach
from adaptsim_jax.effects.joints.forces import ARMATURE
from adaptsim_jax.effects.joints.friction import COULOMB, PRESLIDING, VISCOUS


def scored(
    problem: TreeProblem,
    model: FittedTree,
    reach: Reach,
    laws: bool,
    near: JointCandidate | None = None,
) -> list[CandidateScore]:
    """Scores of all candidates that are laws, or of those that only describe. near: of those alone
    that act beside it.
    """
    every = candidates(problem, model.fit.vector, reach)
    if near is not None:
        every = [c for c in every if adjacent(problem, c, near)]
    return table(
        problem, model.lin, [c for c in every if problem.effect(c.effect).describes is not laws]
    )


def more(large: FittedTree, small: FittedTree) -> int:
    """Fitted parameters that one model has more than another."""

    def fitted(m):
        return sum(e.low < e.high for e in m.fit.vector.entries)

    return fitted(large) - fitted(small)


def keys_of(model: FittedTree, c: JointCandidate) -> list[tuple]:
    """Keys of an effect's entries in a model, shapes too."""
    return [
        e.key
        for e in model.fit.vector.entries
        if e.owner == c.effect and set(e.joints) <= set(c.joints)
    ]


def without(
    problem: TreeProblem, model: FittedTree, gone: JointCandidate, criteria: Criteria
) -> FittedTree:
    """The model without one of its effects, refitted under the same weights."""
    vector = model.fit.vector.without(keys_of(model, gone))
    less = tuple(c for c in model.added if c is not gone)
    begun = vector, model.fit.starts
    return compared(problem, model, less, model, begun, gone.joints, criteria)


def compared(
    problem: TreeProblem,
    model: FittedTree,
    added: Sequence[JointCandidate],
    like: FittedTree,
    begun: tuple[Vector, Sequence[np.ndarray]],
    joints: Sequence[int],
    criteria: Criteria,
) -> FittedTree:
    """Another model, refitted under the weights of `model` as far as it takes to compare them: to
    the end where it might do as well.

    Args:
        problem: stretches.
        model: what it is compared with.
        added: its effects.
        like: a model that is the same but at `joints`.
        begun: vector and starts from which it is fitted.
        joints: at which it is another.
        criteria: rounds, and from which difference on a fit ends early.
    """
    weights, most = model.fit.weights, criteria.rounds
    fitted = refit(problem, *begun, joints, most, weights, 2 * criteria.glance)
    other = modelled(problem, added, fitted, weights, like)
    left = most - fitted.rounds
    separable = paired(problem, other.held.loss, model.held.loss).gain > criteria.worse_share
    if separable or left <= 0 or fitted.code == "stuck":
        return other
    fitted = refit(problem, fitted.vector, fitted.starts, joints, left, weights)
    return modelled(problem, added, fitted, weights, like)


def from_afar(
    problem: TreeProblem, settle: Callable[..., FittedTree], vector: Vector, starts, rounds: int
) -> FittedTree:
    """settle(vector, starts), which fits under given weights; where that is stuck at once, also
    after a fit by weights of its own: what weighs after a good fit is a narrow valley from afar. Of
    both the one that leaves less.
    """
    found = settle(vector, starts)
    if found.fit.code != "stuck":
        return found
    near = fit(problem, vector, starts, rounds=rounds)
    return min(found, settle(near.vector, near.starts), key=lambda m: m.fit.total)


def trimmed(
    problem: TreeProblem, model: FittedTree, keys: Sequence[tuple], criteria: Criteria
) -> FittedTree:
    """The model without some entries of its effects, refitted; as it is where there are none."""
    if not keys:
        return model
    added = []
    for c in model.added:
        left = [e for e in c.entries if e.key not in keys]
        added += [c if len(left) == len(c.entries) else c.at(left)] if left else []
    own = fit(problem, model.fit.vector.without(keys), model.fit.starts, rounds=criteria.rounds)
    return modelled(problem, added, own)


@dataclass(frozen=True)
class SimulatedEvidence(Evidence):
    """Evidence of simulated stretches: a model, and `less` without a candidate, refitted."""

    problem: TreeProblem
    model: FittedTree
    less: FittedTree
    candidate: JointCandidate
    test: Test
    steadiness: float
    criteria: Criteria
    units = "stretches"

    @property
    def level(self) -> float:
        return attainable(self.criteria.confidence, self.test.parts)

    @property
    def price(self) -> float:
        return self.criteria.size * len(self.candidate.entries)

    @property
    def effect(self) -> Effect:
        return self.problem.effect(self.candidate.effect)

    @property
    def own(self) -> list[tuple[Entry, float]]:
        """Its entries in the model, with their values."""
        keys, vector = {e.key for e in self.candidate.entries}, self.model.fit.vector
        both = vector.pairs()
        return [(e, float(z)) for e, z in both if e.key in keys]

    @property
    def between_rows(self) -> bool:
        held = self.test.p <= self.criteria.confidence
        return held and between_rows(self.problem, self.model, self.candidate, self.criteria)

    @property
    def shifts_time(self) -> bool:
        return self.effect.shifts_time

    @property
    def at_bound(self) -> bool:
        names = {a.name for a in self.effect.amplitudes}
        return any(e.at_bound(z, self.criteria.bound) for e, z in self.own if e.name in names)

    @property
    def unresolved_shift(self) -> float | None:
        """The largest at its own joints."""
        times = [abs(z) / self.problem.reach.dt for e, z in self.own if e.unit == "s"]
        if not times or not self.effect.shifts_time:
            return None
        if max(times) < self.criteria.min_shift:
            return max(times)
        return None

    @property
    def declared_change(self) -> float | None:
        """None where the file declares nothing of it."""
        own = [(e.off, z) for e, z in self.own]
        if not own or any(off == 0.0 for off, _ in own):
            return None
        return max(abs(z - off) / abs(off) for off, z in own)

    @property
    def bend(self) -> float | None:
        """At the joint where it is most; of a simulator whose friction turns with tanh(v / width),
        say, no motion shows them.
        """
        if self.candidate.effect != PRESLIDING.name:
            return None
        problem, vector = self.problem, self.model.fit.vector
        values = vector.known()

        def bent(j):
            minimum = 0.01 * float(problem.reach.torque[j])
            level = max(values.get((COULOMB.name, "level", (j,)), 0.0), minimum)
            soft = values.get((self.candidate.effect, "compliance", (j,)), 0.0)
            return soft * level / max(problem.floor[j], 1e-12)

        return max(bent(j) for j in self.candidate.joints)

    @property
    def nearer(self) -> float:
        return eased(self.problem, self.less, self.model)

    @property
    def best_joint(self) -> tuple[float, float]:
        minimum = least_worth(self.effect, self.criteria)
        return worth(self.problem, self.less, self.model), minimum


def least_worth(effect: Effect, criteria: Criteria) -> float:
    """What an effect must take off the squared error of some joint: a form, which fits many, more
    than a law.
    """
    return criteria.described if effect.describes else criteria.worth


def worth(problem: TreeProblem, less: FittedTree, model: FittedTree) -> float:
    """Share of the squared held-out error of one joint's angles that a model takes off another's,
    at the joint where it is most: of the median stretch or of the ninth decile. An error within the
    noise floor counts as the floor, and so does one that is next to nothing beside what the
    declared model leaves (`Problem.least`).
    """
    before, after = (
        np.square(np.quantile(held_error(problem, m), [0.5, 0.9], axis=0)) for m in (less, model)
    )
    floor = np.square(np.maximum(np.maximum(problem.floor[: problem.joints], problem.least), 1e-12))
    return float(np.max((before - after) / np.maximum(before, floor)))


def eased(problem: TreeProblem, less: FittedTree, model: FittedTree) -> float:
    """Share of the held-out error of the angles that a model takes off another's, geometric mean
    over joints: of the median stretch, or of the ninth decile where it is more (an effect that acts
    now and then).

    What only the estimator's weights see is of no use to who simulates.
    """
    before, after = (np.quantile(held_error(problem, m), [0.5, 0.9], axis=0) for m in (less, model))
    return 1.0 - float(
        np.exp(np.min(np.mean(np.log(np.maximum(after, 1e-12) / np.maximum(before, 1e-12)), 1)))
    )


def between_rows(
    problem: TreeProblem, model: FittedTree, c: JointCandidate, criteria: Criteria
) -> bool:
    """Whether it is how commands are read: at all driven joints they act early, by no more than
    those of a controller that is faster than its log (half of the difference of both intervals), or
    late by less than the log resolves; or rotors differ by what damps a joint in a small part of a
    row.
    """
    if c.effect == ARMATURE.name:
        return in_step(problem, model.fit.vector.entries, model.fit.vector.values, criteria)
    driven = {j for j in range(problem.joints) if problem.reach.peak[j] > 0.0}
    times = [z for e, z in model.fit.vector.pairs() if e.key == c.entries[0].key]
    between = (
        bool(times) and -criteria.within_row < times[0] / problem.reach.dt < criteria.min_shift
    )
    shifts = problem.effect(c.effect).pairs_rows and len(c.entries) == 1
    return shifts and between and driven <= set(c.joints)


def in_step(
    problem: TreeProblem, entries: Sequence[Entry], values: np.ndarray, criteria: Criteria
) -> bool:
    """Whether all rotors that are fitted, of two joints or more, differ from the file's by less
    than their damping times the shift in time that the log resolves: damping that acts that much
    earlier does the same.
    """
    at = {e.key: z for e, z in zip(entries, values, strict=True)}
    damping = np.zeros(problem.joints)
    for g in problem.groups:
        damping[list(g.joints)] = -g.actuator[3] * g.gear**2
    damping += [at.get((VISCOUS.name, "damping", (j,)), 0.0) for j in range(problem.joints)]
    shift = criteria.min_shift * problem.reach.dt
    rotors = [
        (abs(at[e.key] - e.off), min(damping[j] for j in e.joints))
        for e in entries
        if e.owner == ARMATURE.name
    ]
    return len(rotors) > 1 and all(heavier < shift * damps for heavier, damps in rotors)


def steadiness(model: FittedTree, c: JointCandidate) -> float:
    """An effect's amplitude over its scatter between folds: the largest of its amplitudes'."""
    return float(np.max(steady_each(model, c)))


def steady_each(model: FittedTree, c: JointCandidate) -> np.ndarray:
    """The amplitudes of an effect [K] over their scatter between folds (jackknife, all other values
    held).

    With the others free, an amplitude that trades places with inertias would scatter, though every
    fold wants it.
    """
    at = [
        i for i, e in enumerate(model.fit.vector.entries) if any(e.key == k.key for k in c.entries)
    ]
    n = model.held.normal
    hess, own = n.hess[:, at][:, :, at], n.slope[:, at]
    ridge = 1e-9 * np.diag(np.diagonal(hess.sum(0)))
    moved = np.array(
        [
            np.linalg.lstsq(hess.sum(0) - h + ridge, -s, rcond=1e-12)[0]
            for h, s in zip(hess, own, strict=True)
        ]
    )
    off = np.array([model.fit.vector.entries[i].off for i in at])
    return np.abs(model.fit.vector.values[at] - off) / np.maximum(jackknife(moved), 1e-12)
