"""What the balance of torques named, held against simulation, without a fit by it.

Where the declared model simulates to within a few times its noise, stretches tell all that there
is: each effect must also simulate left-out stretches better than the balance refitted without it.
Elsewhere simulation has a veto: no joint at which it tells anything
may be simulated worse with a name than without. Where it tells nothing it has no say: stiff arms
simulate worse with right frictions.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from adaptsim_jax.attribution.candidates import JointCandidate, adjacent
from adaptsim_jax.attribution.criteria import CONFIRMATION
from adaptsim_jax.attribution.equation.models import TorqueSearch, model_of, without
from adaptsim_jax.attribution.fitted import FittedTree, held_error, over_floor
from adaptsim_jax.attribution.forecast import without_a_model
from adaptsim_jax.attribution.held_out import paired
from adaptsim_jax.attribution.nested_models import eased, least_worth, worth
from adaptsim_jax.attribution.paths import losses
from adaptsim_jax.attribution.problem import TreeProblem
from adaptsim_jax.core.parallel import parallel_map
from adaptsim_jax.diagnosis.criteria import FOLD, REPORT, Criteria
from adaptsim_jax.diagnosis.finding import Step
from adaptsim_jax.diagnosis.folds import pieces
from adaptsim_jax.diagnosis.objective import Objective
from adaptsim_jax.diagnosis.rules import Evidence, refusal, step_reason
from adaptsim_jax.diagnosis.search import backward_elimination
from adaptsim_jax.diagnosis.testing import Test, paired_test


def confirmed(
    problem: TreeProblem,
    found: TorqueSearch,
    whole: FittedTree,
    criteria: Criteria,
    null: FittedTree,
) -> TorqueSearch:
    """Without the names that simulation does not bear out, refitted by the balance.

    Args:
        problem: stretches that are simulated.
        found: by the balance.
        whole: the model of all that is found.
        criteria: what counts as an effect.
        null: the declared model, whose stretches may tell nothing.
    """
    near = over_floor(problem, null) <= criteria.near
    if not near and not any(informative_joints(problem, null, criteria)):
        return found
    objective = SimulatedNames(problem, criteria, null, near)
    trace: list[Step] = []
    model, _ = backward_elimination(objective, NamedModel(found, whole), trace)
    left = objective.separable(model) if near else model.found
    return replace(left, vetoes=(*found.vetoes, *trace))


@dataclass(frozen=True)
class NamedModel:
    """What a balance found, and how that simulates stretches. Its effects are those with a name."""

    found: TorqueSearch
    whole: FittedTree

    @property
    def added(self) -> tuple[JointCandidate, ...]:
        return tuple(n.candidate for n in self.found.named)


@dataclass(frozen=True)
class SimulatedName(Evidence):
    """Evidence of stretches, simulated with and without a name, both as the balance fits them.

    near: whether stretches tell all that there is; harmed: joints that are simulated worse with it,
    where they do not.
    """

    problem: TreeProblem
    model: NamedModel
    less: NamedModel
    candidate: JointCandidate
    criteria: Criteria
    test: Test
    near: bool
    harmed: Sequence[int] = ()
    units = "stretches"
    steadiness = np.inf
    min_steadiness: ClassVar[float] = 0.0
    at_bound: ClassVar[bool] = False

    @property
    def level(self) -> float:
        return self.criteria.confidence if self.near else 1.0

    @property
    def price(self) -> float:
        return self.criteria.size if self.near else -np.inf

    @property
    def harmed_joints(self) -> int:
        return len(self.harmed)

    @property
    def nearer(self) -> float | None:
        if not self.near:
            return None
        return eased(self.problem, self.less.whole, self.model.whole)

    @property
    def best_joint(self) -> tuple[float, float] | None:
        if not self.near:
            return None
        effect = self.problem.effect(self.candidate.effect)
        gain = worth(self.problem, self.less.whole, self.model.whole)
        return gain, least_worth(effect, self.criteria)


@dataclass(frozen=True)
class SimulatedNames(Objective):
    """Names of a balance as simulated stretches bear them out; nothing is added.

    near: whether stretches tell all that there is; null: as of `confirmed`.
    """

    problem: TreeProblem
    criteria: Criteria
    null: FittedTree
    near: bool
    _certain: set = field(default_factory=set)

    def model(self, found: TorqueSearch, like: FittedTree) -> NamedModel:
        """What is found, simulated from starts of a model that is nearly the same."""
        whole = model_of(self.problem, found, found.final, found.added, like.fit.starts)
        return NamedModel(found, whole)

    def less(self, model: NamedModel, gone: Sequence[JointCandidate]) -> NamedModel:
        """Without some names, refitted by the balance."""
        return self.model(_gone(without(self.problem, model.found, gone, [])), model.whole)

    def members(self, model: NamedModel) -> tuple[NamedModel, Sequence[Step]]:
        """Where all names together take nothing off, none is asked (closed testing; Marcus, Peritz
        and Gabriel, 1976).
        """
        if not self.near or len(model.added) < 2:
            return model, ()
        bare = self.less(model, model.added)
        test = self.test(bare.whole, model.whole)
        if test.gain > self.criteria.size:
            return model, ()
        reason = step_reason("all_names_together", test.gain)
        return bare, [Step("dropped", c, test, reason) for c in model.added]

    def test(self, less: FittedTree, whole: FittedTree) -> Test:
        loss = losses(self.problem, less.held.paths, whole.fit.weights)
        return paired(self.problem, loss, whole.held.loss)

    def evidence(self, model: NamedModel, candidates: Sequence[JointCandidate]) -> list[Evidence]:
        """One that takes far more than the least off is not asked again."""

        def one(c: JointCandidate) -> SimulatedName:
            less = self.less(model, [c])
            test, worse = self.test(less.whole, model.whole), []
            if not self.near:
                shown = _shown(model.found, c)
                worse = harmed(
                    self.problem, self.null, less.whole, model.whole, shown, self.criteria
                )
            return SimulatedName(
                self.problem, model, less, c, self.criteria, test, self.near, worse
            )

        rows = parallel_map(one, [c for c in candidates if c.key not in self._certain])
        if not self.near:
            return list(rows) if any(e.harmed for e in rows) else self._together(model, rows)
        sure = [e for e in rows if e.gain > self.criteria.worse_share and refusal(e) is None]
        self._certain.update(e.candidate.key for e in sure)
        return list(rows)

    def _together(self, model: NamedModel, rows: list[SimulatedName]) -> list[Evidence]:
        """Where no name harms a joint by itself and all of them together do: of those at such
        joints the one that the balance gains least by is taken to.
        """
        null, whole, joints = self.null, model.whole, range(self.problem.joints)
        worse = set(harmed(self.problem, self.null, null, whole, joints, self.criteria))
        some = [n for n in model.found.named if worse & set(_shown(model.found, n.candidate))]
        if not some:
            return list(rows)
        weakest = min(some, key=lambda n: n.test.gain).candidate
        return [replace(e, harmed=tuple(worse)) if e.candidate is weakest else e for e in rows]

    def adjacent(self, candidate: JointCandidate, other: JointCandidate) -> bool:
        return adjacent(self.problem, candidate, other)

    def without(self, model: NamedModel, gone: Sequence[Evidence]) -> NamedModel:
        return gone[0].less if len(gone) == 1 else self.less(model, [e.candidate for e in gone])

    def separable(self, model: NamedModel) -> TorqueSearch:
        """With those alternatives of each name alone that simulate left-out stretches as well in
        its place.
        """
        found, whole = model.found, model.whole

        def as_well(pair: tuple[JointCandidate, JointCandidate]) -> bool:
            instead = without(self.problem, found, [pair[0]], [pair[1]])
            test = self.test(self.model(instead, whole).whole, whole)
            return test.p > self.criteria.confidence or test.gain < self.criteria.gap

        pairs = [(n.candidate, other) for n in found.named for other in n.alternatives]
        if not pairs:
            return found
        good = parallel_map(as_well, pairs)
        alike = {(c.key, o.key) for (c, o), g in zip(pairs, good, strict=True) if g}

        def separated(n):
            others = tuple(o for o in n.alternatives if (n.candidate.key, o.key) in alike)
            return replace(n, alternatives=others)

        searches = [replace(w, named=tuple(separated(n) for n in w.named)) for w in found.searches]
        return replace(found, searches=tuple(searches))


def informative_joints(problem: TreeProblem, null: FittedTree, criteria: Criteria) -> list[bool]:
    """At which joints simulated stretches of the declared model `null` tell anything: they come
    within a few times the noise, or beat what needs no model.
    """
    error = np.median(held_error(problem, null), 0)
    nothing = np.min([np.median(z, 0) for z in without_a_model(problem)], 0)
    near = error <= criteria.near * problem.floor[: problem.joints]
    return list(near | (error < (1.0 - REPORT.worthless_skill) * nothing))


def harmed(
    problem: TreeProblem,
    null: FittedTree,
    less: FittedTree,
    more: FittedTree,
    joints: Iterable[int],
    criteria: Criteria,
) -> list[int]:
    """Those of `joints` that `more` simulates worse than `less`, beyond its own test, where
    stretches predict anything.
    """
    informative = informative_joints(problem, null, criteria)
    count = len(problem.fold)
    block = pieces(problem.groups[0].stretches.trial[:count], FOLD.test_pieces)
    one, two = (np.square(held_error(problem, m)) for m in (less, more))
    out = []
    for j in joints:
        test = paired_test(two[:, j], one[:, j], problem.fold, block)
        if informative[j] and test.gain > CONFIRMATION.harm and test.p <= criteria.confidence:
            out.append(j)
    return out


def _shown(found: TorqueSearch, c: JointCandidate) -> list[int]:
    """Joints of the machine at which an effect shows."""
    for w in found.searches:
        if any(k is c for k in w.added):
            return [w.balance.group.joints[k] for k in w.state.own(c)]
    return list(c.joints)


def _gone(less: TorqueSearch) -> TorqueSearch:
    """What is found less, without the names that are no longer in it."""

    def names(w):
        return tuple(k for k in w.named if any(k.candidate is c for c in w.added))

    return replace(less, searches=tuple(replace(w, named=names(w)) for w in less.searches))
