"""Short trials as an objective of the search: pushes, tosses, scoops, and the stretches of a
simulator.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from adaptsim_jax.diagnosis.criteria import LOOK_ALIKE, Criteria
from adaptsim_jax.diagnosis.finding import Finding
from adaptsim_jax.diagnosis.fit import completed, declared_fit, mean_square
from adaptsim_jax.diagnosis.models import (
    Model,
    Score,
    added,
    beats,
    finished,
    paired,
    scored,
    spread,
    without,
)
from adaptsim_jax.diagnosis.objective import FittedCandidate, Objective, Round
from adaptsim_jax.diagnosis.problem import Problem
from adaptsim_jax.diagnosis.rules import Evidence, Reason, step_reason
from adaptsim_jax.diagnosis.search import Keep, search
from adaptsim_jax.diagnosis.testing import Test, attainable, holm
from adaptsim_jax.effects.base import Effect

Progress = Callable[[str], None]


def search_trials(
    problem: Problem,
    criteria: Criteria,
    notify: Progress = lambda note: None,
    alike: bool = True,
    keep: Keep = lambda found: None,
) -> Finding:
    """What the trials of a problem show; arguments as of `search`."""
    return search(TrialObjective(problem, criteria, notify), keep, alike)


@dataclass(frozen=True)
class TrialObjective(Objective):
    """Trials of a problem, each left out in turn. notify: gets what is tried."""

    problem: Problem
    criteria: Criteria
    notify: Progress = lambda note: None
    _scored: list = field(default_factory=list)  # the last model that was scored, and its scores

    @property
    def most_effects(self) -> int:
        return self.criteria.most_effects

    def declared(self) -> Model:
        self.notify("declared model")
        noise = self.criteria.lacks_nothing**2 or np.inf
        return Model((), declared_fit(self.problem, 3 * self.criteria.rounds, noise))

    def scores(self, model: Model) -> list[Score]:
        if not self._scored or self._scored[0] is not model:
            self._scored[:] = model, scored(self.problem, model)
        return self._scored[1]

    def within_noise(self, model: Model) -> bool:
        return model.fit.loss < self.criteria.lacks_nothing**2 * self.problem.counts.sum()

    def rounds(self, base: Model) -> Iterator[Round]:
        scores = self.scores(base)
        family = max(len(scores), 1)
        passing = [s for s in scores if s.p * family < self.criteria.alpha]
        ended = step_reason("score_test", passed=len(passing), of=len(scores))
        yield Round(self._fitted(base, passing), ended)

    def _fitted(self, base: Model, passing: Sequence[Score]) -> Iterator[FittedCandidate]:
        """Some that pass the score test, fitted at a glance, and of these the best to the end."""
        problem, criteria, glances = self.problem, self.criteria, []
        for s in sorted(passing, key=lambda s: -s.gain)[: criteria.tried]:
            self.notify(s.candidate.name.replace("_", " "))
            values, loss = added(problem, base, s, criteria.glance)
            glances.append((loss, values, s.candidate))
        glances.sort(key=lambda g: g[0])
        passed = False
        for loss, values, candidate in glances[: criteria.tried // 2]:
            if passed and loss > (1.0 + criteria.behind) * glances[0][0]:
                return
            model = finished(problem, (*base.added, candidate), values, criteria.rounds)
            test = paired(base.fit.held, model.fit.held, problem)
            reason = forward_refusal(test, criteria)
            passed = passed or reason is None
            yield FittedCandidate(candidate, model, test, reason is None, reason)

    def better(self, one: FittedCandidate, other: FittedCandidate) -> bool:
        return beats(self.problem, one.model, other.model, self.criteria)

    def taken(self, attempt: FittedCandidate) -> Model:
        return self._refitted(attempt.model)

    def updated(self, null: Model) -> Model:
        """With starts and weights as the model that was taken made them anew."""
        if self.problem.anew is None:
            return null
        return Model(null.added, completed(self.problem, null.fit.free, null.fit.values))

    def _refitted(self, model: Model) -> Model:
        """A model that was taken, fitted on with starts found for it."""
        if self.problem.anew is None:
            return model
        self.problem.anew(model.fit.values)
        return finished(self.problem, model.added, model.fit.values, self.criteria.rounds)

    def evidence(self, model: Model, candidates: Sequence[Effect]) -> list[Evidence]:
        """Levels of the paired tests are Holm's, over all effects of the model."""
        rows = []
        for c in candidates:
            self.notify(f"without {c.name.replace('_', ' ')}")
            less = without(self.problem, model, c, 2 * self.criteria.rounds)
            test = paired(less.fit.held, model.fit.held, self.problem)
            steady = steadiness(self.problem, model, c)
            level = self.criteria.confidence
            rows.append(LeftOut(self.problem, model, less, c, self.criteria, test, level, steady))
        blocks = min((e.test.parts for e in rows), default=1)
        levels = holm([e.test.p for e in rows], self.criteria.confidence, blocks)
        return [replace(e, level=level) for e, level in zip(rows, levels, strict=True)]

    def in_place_of(self, e: "LeftOut") -> Iterator[FittedCandidate]:
        problem, criteria = self.problem, self.criteria
        for s in likely(problem, e.model, e.less, e.candidate):
            self.notify(f"{s.candidate.name.replace('_', ' ')} in its place")
            values, loss = added(problem, e.less, s, 2 * criteria.glance)
            if loss > LOOK_ALIKE.max_loss * e.model.fit.loss:
                continue
            other = finished(problem, (*e.less.added, s.candidate), values, 2 * criteria.rounds)
            test = paired(other.fit.held, e.model.fit.held, problem)
            yield FittedCandidate(s.candidate, other, test, does_as_well(test, criteria))

    def closed(self, null: Model, model: Model, rows: Sequence["LeftOut"]) -> tuple[Model, Model]:
        """A declared fit reached by way of an effect may lie in a better minimum than the first."""
        bare = [m for m in (model, *(e.less for e in rows)) if not m.added]
        null = min((null, *bare), key=lambda m: m.fit.loss)
        if not rows:
            return null, model
        model = self._refitted(model)
        return self.updated(null), model


def forward_refusal(test: Test, criteria: Criteria) -> Reason | None:
    """Why a candidate is not added."""
    if test.gain < criteria.size:
        return step_reason("forward_gain", test.gain)
    if test.p > attainable(criteria.confidence, test.parts):
        return step_reason("forward_level", test.p)
    return None


def does_as_well(test: Test, criteria: Criteria) -> bool:
    """Whether a look-alike's model is hardly worse than that of a name; test: of the name's model
    against it.
    """
    return test.gain < criteria.gap or test.p > criteria.confidence


def likely(problem: Problem, model: Model, less: Model, gone: Effect) -> list[Score]:
    """Effects that may do as well as what `less` lacks: one step in its place takes off a part of
    what it does.
    """
    minimum = LOOK_ALIKE.min_step_gain * (1.0 - model.fit.loss / less.fit.loss)
    known = (gone, *model.added)
    return [s for s in scored(problem, less) if s.candidate not in known and s.gain >= minimum]


@dataclass(frozen=True)
class LeftOut(Evidence):
    """Evidence of trials that are left out: a model and `less`, the one without a candidate."""

    problem: Problem
    model: Model
    less: Model
    candidate: Effect
    criteria: Criteria
    test: Test
    level: float
    steadiness: float

    @property
    def price(self) -> float:
        return self.criteria.size

    @property
    def at_bound(self) -> bool:
        quantities = self.problem.quantities
        for i in self.problem.at(amplitudes(self.candidate)):
            q, value = quantities[i], self.model.fit.values[i]
            ends = [z for z in (q.low, q.high) if np.isfinite(z) and z != q.default]
            if any(abs(value - z) <= self.criteria.bound * abs(z) for z in ends):
                return True
        return False

    @property
    def scaled_change(self) -> float:
        at = self.problem.at(self.candidate.names)
        scale = np.array([self.problem.quantities[i].scale for i in at])
        moved = np.abs(self.model.fit.values[at] - self.problem.neutral[at])
        return float(np.max(moved / scale))

    @property
    def left_without(self) -> float:
        return float(np.sqrt(self.less.fit.loss / self.problem.counts.sum()))

    @property
    def beyond_noise(self) -> float | None:
        """Of the sum or of the median over trials, the larger; not asked where the median is at the
        noise.

        A body that moves by other laws than the model's is followed better by any effect that
        resembles the difference.
        """
        after, before = (_middle(self.problem, m) for m in (self.model, self.less))
        if not self.criteria.beyond or after <= self.criteria.lacks_nothing**2:
            return None
        noise = float(self.problem.counts.sum())
        whole = _share(self.less.fit.loss, self.model.fit.loss, noise)
        return max(whole, _share(before, after, 1.0))


def _middle(problem: Problem, model: Model) -> float:
    """Median over trials of the mean square that is left."""
    return float(np.median(mean_square(problem, model.fit.residual)))


def _share(before: float, after: float, noise: float) -> float:
    return (before - after) / max(before - noise, 1e-9)


def amplitudes(c: Effect) -> list[str]:
    """Quantities of a candidate that are no places."""
    return [q for q in c.names if all(q not in shape for shape in c.points)]


def steadiness(problem: Problem, model: Model, c: Effect) -> float:
    """Size over scatter of the steadiest amplitude, of places where there is no other."""
    at = problem.at(amplitudes(c) or c.names)
    size = np.abs(model.fit.values[at] - problem.neutral[at])
    return float(np.max(size / np.maximum(spread(problem, model)[at], 1e-12)))
