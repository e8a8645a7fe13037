"""Simulated stretches of a mechanism as an objective of the search for effects, and what the search
finds of it.

Models are compared by folds (trials) that were left out of the parameters with which they are
predicted (`held_out.py`), under the weights of one of both.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from adaptsim_jax.attribution.candidates import (
    CandidateScore,
    JointCandidate,
    adjacent,
    candidates,
    where,
)
from adaptsim_jax.attribution.estimate import fit, settled
from adaptsim_jax.attribution.fitted import (
    FittedTree,
    Hint,
    Selection,
    astray,
    held_error,
    over_floor,
)
from adaptsim_jax.attribution.held_out import (
    attempted,
    evenly_weighted,
    modelled,
    paired,
    placed,
    refit,
)
from adaptsim_jax.attribution.nested_models import (
    SimulatedEvidence,
    compared,
    eased,
    from_afar,
    keys_of,
    more,
    scored,
    steadiness,
    steady_each,
    trimmed,
    without,
)
from adaptsim_jax.attribution.parameters import Vector
from adaptsim_jax.attribution.paths import losses
from adaptsim_jax.attribution.problem import TreeProblem, beginnings, own_inertia, scaled_reach
from adaptsim_jax.attribution.score import table
from adaptsim_jax.core.parallel import parallel_map
from adaptsim_jax.diagnosis.criteria import LOOK_ALIKE, Criteria
from adaptsim_jax.diagnosis.finding import Finding, Step
from adaptsim_jax.diagnosis.objective import FittedCandidate, Objective, Refused, Round
from adaptsim_jax.diagnosis.rules import MODEL, NAME, Evidence, Reason, refusal, step_reason
from adaptsim_jax.diagnosis.search import look_alikes, search
from adaptsim_jax.diagnosis.testing import Test, preferred
from adaptsim_jax.effects.base import Reach

DECLARED_ROUNDS = 15  # rounds of the declared model's fit: bounds its time
Passes = Callable[[FittedTree, Test], bool]


class Start(NamedTuple):
    """A candidate that was scored, and the model with it one step on."""

    score: CandidateScore
    vector: Vector
    starts: Any
    loss: np.ndarray

    @property
    def candidate(self) -> JointCandidate:
        return self.score.candidate


@dataclass(frozen=True)
class TreeObjective(Objective):
    """Stretches of a problem.

    null: the declared model, fitted; again: fits it from where it begins, where `null` was only
    fitted roughly, to be compared with `hint`; alike: whether simpler look-alikes take a name.
    """

    problem: TreeProblem
    null: FittedTree
    reach: Reach
    criteria: Criteria
    notify: Callable[[str], None] = lambda note: None
    hint: Hint | None = None
    again: Callable[[], FittedTree] | None = None
    alike: bool = True
    _scores: dict = field(default_factory=dict)
    _rivals: dict = field(default_factory=dict)
    _replaced: set = field(default_factory=set)

    @property
    def most_effects(self) -> int:
        return self.criteria.most_effects

    def declared(self) -> FittedTree:
        return self.null

    def scores(self, model: FittedTree) -> list[CandidateScore]:
        both = self.scores_of(model, True) + self.scores_of(model, False)
        return sorted(both, key=lambda s: -s.held_out)

    def scores_of(self, model: FittedTree, laws: bool) -> list[CandidateScore]:
        """Of candidates that are laws, or of those that only describe."""
        key = id(model), laws
        if key not in self._scores:
            self._scores[key] = model, scored(self.problem, model, self.reach, laws)
        return self._scores[key][1]

    def begun(self, null: FittedTree) -> tuple[FittedTree, Sequence[Step]]:
        """With what another objective found, where that predicts better."""
        if self.hint is None:
            return null, ()
        problem, criteria, (vector, added) = self.problem, self.criteria, self.hint
        model = modelled(problem, added, fit(problem, vector, rounds=DECLARED_ROUNDS))
        test = paired(problem, null.held.loss, losses(problem, model.held.paths, null.fit.weights))
        if not preferred(test, criteria.size, criteria.confidence):
            return null, ()
        reason = step_reason("begin_from_other", test.gain)
        return self._steady(model), [Step("added", c, test, reason) for c in added]

    def _steady(self, model: FittedTree) -> FittedTree:
        """Without the joints at which an effect that was put in at many differs between folds by as
        much as it is.
        """
        gone = [
            e.key
            for c in model.added
            if c.sharing == "all"
            for e, steady in zip(c.entries, steady_each(model, c), strict=True)
            if steady < self.criteria.steady
        ]
        return trimmed(self.problem, model, gone, self.criteria)

    def rounds(self, base: FittedTree) -> Iterator[Round]:
        """Laws; where none holds out any more, what acts now and then; then what only describes."""
        yield self._round(base, True)
        yield from self._now_and_then(base)
        yield self._round(base, False)

    def _round(self, base: FittedTree, laws: bool) -> Round:
        criteria, scores = self.criteria, self.scores_of(base, laws)
        family = max(len(self.scores(self.null)), 1)
        minimum = 0.5 * criteria.size * base.fit.total
        hopeful = [s for s in scores if s.p * family < criteria.alpha and s.held_out > minimum]
        ended = step_reason("score_test", passed=len(hopeful), of=len(scores))
        return Round(self._scored_best(base, scores, hopeful), ended)

    def _scored_best(
        self, base: FittedTree, scores: list[CandidateScore], hopeful: list[CandidateScore]
    ) -> Iterator[FittedCandidate]:
        """Half by what they gain at first order, half by what a step leaves."""
        criteria = self.criteria

        def passes(model, test):
            return (
                test.gain > criteria.size * max(1, more(model, base))
                and test.better > 0.5 * test.folds
                and test.p <= criteria.confidence
            )

        begun = self._begun(base, hopeful[: 2 * criteria.tried])
        first = criteria.tried // 2
        begun = begun[:first] + sorted(begun[first:], key=lambda b: b.loss.sum())
        begun = begun[: criteria.tried]
        begun += self._begun(base, self._larger(scores, begun))
        yield from self._fitted(base, begun, passes)

    def _larger(self, scores: list[CandidateScore], begun: Sequence[Start]) -> list[CandidateScore]:
        """Of what is not tried what has some of it as a special case at the same joints."""
        done = {(b.candidate.effect, b.candidate.joints) for b in begun}
        tried = {b.candidate.key for b in begun}

        def holds(c):
            contains = self.problem.effect(c.effect).contains
            return any((name, c.joints) in done for name in contains)

        return [s for s in scores if s.candidate.key not in tried and holds(s.candidate)]

    def _begun(self, base: FittedTree, scores: Sequence[CandidateScore]) -> list[Start]:
        """The base with each candidate added, one step on."""

        def one(score):
            return Start(score, *attempted(self.problem, base, self.reach, score))

        return parallel_map(one, scores)

    def _now_and_then(self, base: FittedTree) -> Iterator[Round]:
        """Effects that act now and then only (a limit that few torques reach, a stop that few
        motions come to), where all else is explained and a few stretches are far off.

        Among all stretches these have next to no weight, and a score test sees few.
        """
        problem, criteria = self.problem, self.criteria
        outlying = astray(problem, base, criteria)
        if outlying.sum() < criteria.few or over_floor(problem, base) > criteria.explained:
            return
        even = evenly_weighted(problem, base.fit, np.flatnonzero(outlying))
        plain = modelled(problem, base.added, even)

        def left(start):
            return float(np.median(start.loss[: len(outlying)][outlying]))

        def passes(model, test):
            error = held_error(problem, model)[outlying] / held_error(problem, plain)[outlying]
            return bool(test.p < criteria.confidence and np.median(error) < criteria.left)

        starts = sorted(self._rare(plain, left), key=left)[: criteria.tried]
        yield Round(self._fitted(plain, starts, passes))

    def _rare(self, plain: FittedTree, left: Callable[[Start], float]) -> list[Start]:
        """Of each candidate the start that leaves least: a step from its score, or where it is put
        in at once. left: what a start leaves.
        """
        every = candidates(self.problem, plain.fit.vector, self.reach)
        scores = {s.candidate.key: s for s in table(self.problem, plain.lin, every)}
        minimum = self.criteria.size * plain.fit.total
        hopeful = [s for s in scores.values() if s.held_out > minimum][: self.criteria.tried]
        begun = {b.candidate.key: b for b in self._begun(plain, hopeful)}
        tries = parallel_map(
            lambda s: placed(self.problem, plain, self.reach, s.candidate), scores.values()
        )
        for key, found in zip(scores, tries, strict=True):
            for c, there in found:
                start = Start(replace(scores[key], candidate=c), *there)
                if key not in begun or left(start) < left(begun[key]):
                    begun[key] = start
        return list(begun.values())

    def _fitted(
        self, base: FittedTree, begun: Sequence[Start], passes: Passes
    ) -> Iterator[FittedCandidate]:
        """Candidates, fitted under the weights of the base."""
        problem, weights, rounds = self.problem, base.fit.weights, self.criteria.rounds

        def fitted(start: Start) -> FittedTree:
            c, glance = start.candidate, 2 * self.criteria.glance
            self.notify(f"{c.effect} at {where(problem, c)}")

            def settle(vector, starts):
                found = refit(problem, vector, starts, c.joints, rounds, weights, glance)
                return modelled(problem, (*base.added, c), found, weights, base)

            return from_afar(problem, settle, start.vector, start.starts, rounds)

        for start, model in zip(begun, parallel_map(fitted, begun), strict=True):
            test = paired(problem, base.held.loss, model.held.loss)
            reason = step_reason("forward_fit", model.fit.total / base.fit.total)
            yield FittedCandidate(start.candidate, model, test, passes(model, test), reason)

    def better(self, one: FittedCandidate, other: FittedCandidate) -> bool:
        """The one with fewer parameters, unless the larger holds out better by `size` for each that
        it has more.
        """
        models = one.model, other.model
        small, large = sorted(models[::-1], key=lambda m: len(m.fit.vector))
        test = paired(self.problem, small.held.loss, large.held.loss)
        minimum = self.criteria.size * max(1, more(large, small))
        chosen = large if test.gain > minimum and test.p < self.criteria.confidence else small
        return chosen is one.model

    def taken(self, attempt: FittedCandidate) -> FittedTree:
        """With its own weights from here on: the residual has become smaller, and with it what
        matters in it.
        """
        fitted, (*before, _) = attempt.model.fit, attempt.model.added
        again = fit(self.problem, fitted.vector, fitted.starts, rounds=self.criteria.rounds)
        acting, still = acting_joints(again.vector, attempt.candidate)
        again = replace(again, vector=again.vector.without(still))
        return modelled(self.problem, (*before, acting), again)

    def members(self, model: FittedTree) -> tuple[FittedTree, Sequence[Step]]:
        """Effects at many joints at those that show them: each joint is tested beside all else, as
        if it were an effect of its own.

        Those that do not hold out go together; where that predicts worse, the weaker half.
        """
        problem, criteria = self.problem, self.criteria
        many = [c for c in model.added if c.sharing == "all" and len(c.joints) > 1]

        def tested(c: JointCandidate, one: JointCandidate) -> tuple[Evidence, Reason | None]:
            alone = replace(model, added=(*(k for k in model.added if k is not c), one))
            e = self._evidence_of(alone, one)
            return e, refusal(e, (MODEL, NAME))

        parts = [(c, one) for c in many for one in c.split()]
        rows = parallel_map(lambda part: tested(*part), parts)
        weak = sorted(((e, why) for e, why in rows if why), key=lambda r: r[0].test.gain)
        while weak:
            keys = [entry.key for e, _ in weak for entry in e.candidate.entries]
            less = trimmed(problem, model, keys, criteria)
            loss = losses(problem, less.held.paths, model.fit.weights)
            test = paired(problem, loss, model.held.loss)
            if test.p > criteria.confidence or test.gain < criteria.size * more(model, less):
                return less, [Step("dropped", e.candidate, e.test, why) for e, why in weak]
            weak = weak[: len(weak) // 2]
        return model, ()

    def evidence(self, model: FittedTree, candidates: Sequence[JointCandidate]) -> list[Evidence]:
        return parallel_map(lambda c: self._evidence_of(model, c), candidates)

    def _evidence_of(self, model: FittedTree, c: JointCandidate) -> Evidence:
        self.notify(f"without {c.effect} at {where(self.problem, c)}")
        less = without(self.problem, model, c, self.criteria)
        test = paired(self.problem, less.held.loss, model.held.loss)
        steady = steadiness(model, c)
        return SimulatedEvidence(self.problem, model, less, c, test, steady, self.criteria)

    def tested_last(self, e: Evidence) -> bool:
        return e.test.gain > self.criteria.worse_share

    def reduced(self, model: FittedTree, refused: Refused) -> tuple[FittedTree, Sequence[Step]]:
        """What is how rows are read stays fitted, and is no effect any more."""
        rows = [(e, reason) for e, reason in refused if e.between_rows]
        if not rows:
            return super().reduced(model, refused)
        e, reason = rows[-1]
        added = tuple(k for k in model.added if k is not e.candidate)
        return replace(model, added=added), [Step("read", e.candidate, e.test, reason)]

    def adjacent(self, candidate: JointCandidate, other: JointCandidate) -> bool:
        return adjacent(self.problem, candidate, other)

    def without(self, model: FittedTree, gone: Sequence[Evidence]) -> FittedTree:
        less, others = gone[0].less, [e.candidate for e in gone[1:]]
        added = [c for c in less.added if all(c is not k for k in others)]
        vector = less.fit.vector.without([key for c in others for key in keys_of(model, c)])
        return self._refitted(added, vector, less)

    def _refitted(
        self, added: Sequence[JointCandidate], vector: Vector, like: FittedTree
    ) -> FittedTree:
        """Under weights of its own."""
        own = fit(self.problem, vector, like.fit.starts, rounds=self.criteria.rounds)
        return modelled(self.problem, added, own)

    def simpler(
        self, model: FittedTree, rows: Sequence[Evidence]
    ) -> tuple[FittedTree, Sequence[Step]]:
        """With a look-alike of fewer parameters in the place of an effect: it has the name."""
        self._rivals.clear()
        if not self.alike:
            return model, ()
        size, gap = self.criteria.size, self.criteria.gap
        count = len(model.fit.vector)
        found = []
        for e in rows:
            for one in look_alikes(self, e):
                if one.candidate.key in self._replaced or len(one.model.fit.vector) >= count:
                    continue
                if one.test.gain < max(gap, size * more(model, one.model)):
                    found.append((e, one))
        if not found:
            return model, ()
        e, one = min(found, key=lambda f: f[1].test.gain)
        self._replaced.add(e.candidate.key)
        gain, name = one.test.gain, one.candidate.effect
        reason = step_reason("simpler_has_the_name", gain, one=name)
        new = self._refitted(one.model.added, one.model.fit.vector, one.model)
        return new, [Step("replaced", e.candidate, one.test, reason)]

    def in_place_of(self, e: Evidence) -> list[FittedCandidate]:
        """Fitted once, for those that are simpler and for those that are reported."""
        if id(e) not in self._rivals:
            self._rivals[id(e)] = e, self._instead(e)
        return self._rivals[id(e)][1]

    def _instead(self, e: Evidence) -> list[FittedCandidate]:
        """Of those that gain most without an effect at its joints or those beside them, and of
        those that it is mistaken for. What describes without a law is no rival of one: it does
        nearly as well as most.
        """
        problem, criteria, c, less = self.problem, self.criteria, e.candidate, e.less
        gained = paired(problem, less.held.loss, e.model.held.loss).gain
        gap = max(criteria.gap, 1.0 - (1.0 - gained) ** criteria.alike)

        def instead(score: CandidateScore) -> FittedCandidate:
            self.notify(f"{score.candidate.effect} in place of {c.effect}")
            touched, added = (*c.joints, *score.candidate.joints), (*less.added, score.candidate)

            def settle(vector, starts):
                begun = vector, starts
                return compared(problem, e.model, added, less, begun, touched, criteria)

            vector, starts, _ = attempted(problem, less, self.reach, score)
            other = from_afar(problem, settle, vector, starts, criteria.rounds)
            test = paired(problem, other.held.loss, e.model.held.loss)
            passed = test.gain < gap or test.p > criteria.confidence
            return FittedCandidate(score.candidate, other, test, passed)

        return parallel_map(instead, self._likely(c, less)[: LOOK_ALIKE.fitted])

    def _likely(self, c: JointCandidate, less: FittedTree) -> list[CandidateScore]:
        """Effects that may do as well as one that `less` lacks."""
        effect = self.problem.effect(c.effect)
        scores = scored(self.problem, less, self.reach, True, c)
        if effect.describes:
            forms = scored(self.problem, less, self.reach, False, c)
            scores = sorted(scores + forms, key=lambda s: -s.held_out)
        own = next((s.held_out for s in scores if s.candidate.key == c.key), 0.0)

        def rival(s: CandidateScore) -> bool:
            other = s.candidate
            same = other.effect == c.effect and bool(set(c.joints) & set(other.joints))
            share = (
                LOOK_ALIKE.near_gain
                if other.effect in effect.look_alikes
                else LOOK_ALIKE.other_gain
            )
            return other.key != c.key and not same and s.held_out > share * own

        return [s for s in scores if rival(s)]

    def closed(
        self, null: FittedTree, model: FittedTree, rows: Sequence[Evidence]
    ) -> tuple[FittedTree, FittedTree]:
        """Where nothing is found both are one: by way of what went a fit may end elsewhere."""
        if model.fit.vector.index().keys() != null.fit.vector.index().keys():
            return null, model
        if self.hint is not None and self.again is not None:
            null = self.again()
        return null, null


def acting_joints(vector: Vector, c: JointCandidate) -> tuple[JointCandidate, list[tuple]]:
    """A candidate at the joints where it does anything, and the keys of its entries at the
    others.
    """
    values = vector.known()
    if c.sharing != "all" or all(values[e.key] == e.off for e in c.entries):
        return c, []
    still = [e for e in c.entries if values[e.key] == e.off]
    return c.at([e for e in c.entries if e not in still]), [e.key for e in still]


def select(
    problem: TreeProblem,
    null: Vector,
    criteria: Criteria,
    notify: Callable[[str], None] = lambda note: None,
    keep: "Callable[[Selection], None]" = lambda found: None,
    hint: Hint | None = None,
) -> Selection:
    """What simulated stretches show.

    Args:
        problem: stretches and candidates.
        null: what is fitted whatever is named, where its fit begins.
        criteria: what counts as an effect.
        notify: gets what is tried.
        keep: gets what is found, as it goes.
        hint: values and effects to go on from, of another objective, if they predict left-out folds
            better than the declared model.
    """
    first = declared(problem, null, criteria, roughly=hint is not None)
    notify("candidates")
    reach = scaled_reach(problem, *own_inertia(problem, first.fit.vector))
    smallest = criteria.noise_share * np.median(held_error(problem, first), 0)
    objective = TreeObjective(
        replace(problem, least=smallest),
        first,
        reach,
        criteria,
        notify,
        hint,
        lambda: declared(problem, null, criteria),
    )

    def selection(found: Finding, last: tuple[CandidateScore, ...] = ()) -> Selection:
        named = tuple(replace(n, models=()) for n in found.named)
        return Selection(**vars(replace(found, named=named)), last=last, reach=reach)

    found = search(objective, lambda found: keep(selection(found)))
    return selection(found, tuple(objective.scores_of(found.stages[-1], True)))


def declared(
    problem: TreeProblem, null: Vector, criteria: Criteria, roughly: bool = False
) -> FittedTree:
    """The declared model fitted; where that leaves far more than noise, also by way of the
    stretches' beginnings, over which a fit has fewer minima: of both the one that predicts better.
    roughly: only as far as another is to be compared with it.
    """
    glance = 2 * criteria.glance if roughly else None
    models = [modelled(problem, (), fit(problem, null, rounds=DECLARED_ROUNDS, glance=glance))]
    if (
        not roughly
        and criteria.beginning < 1.0
        and over_floor(problem, models[0]) > criteria.outlying
    ):
        begun = fit(beginnings(problem, criteria.beginning), null, rounds=DECLARED_ROUNDS)
        models.append(
            modelled(problem, (), fit(problem, begun.vector, begun.starts, rounds=DECLARED_ROUNDS))
        )
    return min(models, key=lambda m: over_floor(problem, m))


def select_shorter(
    problem: TreeProblem,
    null: Vector,
    criteria: Criteria,
    found: Selection,
    notify: Callable[[str], None] = lambda note: None,
) -> Selection:
    """A search over the beginnings of the stretches, where one over the whole named nothing and far
    more than noise is left.

    A joint that friction holds still, or a motion that runs away, has as many minima as it has
    turns. Over a short while it has few (progressive horizons in multiple shooting). What is named
    there is put into the whole, refitted only if that predicts better.
    """
    short = beginnings(problem, criteria.beginning)
    near = select(
        short, null, replace(criteria, beginning=1.0), notify
    )  # beginnings have none of their own
    if not near.named:
        return found
    vector = near.final.fit.vector
    starts, loss, _ = settled(
        problem, found.null.lin, vector, (near.final.fit.starts, found.null.fit.starts), refine=3
    )
    retained = replace(found.null.fit, vector=vector, starts=starts, loss=loss, code="stopped")
    refitted = fit(problem, vector, starts, rounds=criteria.rounds)
    models = [modelled(problem, near.final.added, f) for f in (retained, refitted)]
    final = min(models, key=lambda m: over_floor(problem, m))
    if eased(problem, found.null, final) < 0.0:
        return found
    return replace(near, null=found.null, final=final, stages=(found.null,), shorter=True)
