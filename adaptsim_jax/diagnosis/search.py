"""Which effects trials show: forward by score tests and left-out trials, backward by nested models,
then against look-alikes.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.finding import Finding, Named, Step
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
from adaptsim_jax.diagnosis.problem import Candidate, Problem
from adaptsim_jax.diagnosis.rules import Evidence, Reason, refusal, step_reason
from adaptsim_jax.diagnosis.testing import Test, attainable

CLOSE = 1.5  # of the named model's loss, up to which a look-alike is fitted to the end
LIKELY = 0.1  # of what a name takes off, which one step of a look-alike must take off in its place

Progress = Callable[[str], None]


def search(
    problem: Problem,
    criteria: Criteria,
    notify: Progress = lambda note: None,
    alike: bool = True,
    keep: Callable[[Finding], None] = lambda found: None,
) -> Finding:
    """What the trials of a problem show.

    Args:
        problem: residuals and columns of what is diagnosed.
        criteria: what counts as an effect.
        notify: told what is tried.
        alike: whether look-alikes of what is named are sought.
        keep: told of what is found, as it goes.
    """
    notify("declared model")
    model = null = declared(problem, criteria)
    opening = scores = scored(problem, model)
    trace: list[Step] = []

    def partial(null: Model, model: Model) -> Finding:
        return Finding(null, model, (), tuple(trace), tuple(opening))

    keep(partial(null, model))
    while len(model.added) < criteria.most_effects and not within_noise(problem, model, criteria):
        better = forward_step(problem, model, scores, criteria, trace, notify)
        if better is None:
            break
        model, null = _refitted(problem, better, criteria), _updated(problem, null)
        keep(partial(null, model))
        scores = scored(problem, model)
    model, rows, bare = backward_elimination(problem, model, criteria, trace, notify)
    # a declared fit reached by way of an effect may lie in a better minimum than the first
    null = min((null, *bare), key=lambda m: m.fit.loss)
    named = tuple(_named(e, look_alikes(e, notify) if alike else []) for e in rows)
    if named:
        model, null = _refitted(problem, model, criteria), _updated(problem, null)
    return Finding(null, model, named, tuple(trace), tuple(opening))


def _named(e: "LeftOut", alike: list[tuple[Candidate, Model]]) -> Named:
    others, models = tuple(c for c, _ in alike), tuple(m for _, m in alike)
    return Named(e.candidate, e.test, e.steadiness, others, models)


def declared(problem: Problem, criteria: Criteria) -> Model:
    """The declared model, fitted."""
    return Model((), declared_fit(problem, 3 * criteria.rounds, criteria.quiet**2 or np.inf))


def forward_step(
    problem: Problem,
    base: Model,
    scores: list[Score],
    criteria: Criteria,
    trace: list[Step],
    notify: Progress,
) -> Model | None:
    """The best model with one candidate more that predicts left-out trials better; None where none
    does. Of those whose score test passes some are fitted at a glance, and the best to the end.
    """
    family = max(len(scores), 1)
    passing = [s for s in scores if s.p * family < criteria.alpha]
    glances = []
    for s in sorted(passing, key=lambda s: -s.gain)[: criteria.tried]:
        notify(s.candidate.name.replace("_", " "))
        values, loss = added(problem, base, s, criteria.glance)
        glances.append((loss, values, s.candidate))
    glances.sort(key=lambda g: g[0])
    best = None
    for loss, values, candidate in glances[: criteria.tried // 2]:
        if best is not None and loss > (1.0 + criteria.behind) * glances[0][0]:
            break
        model = finished(problem, (*base.added, candidate), values, criteria.rounds)
        test = paired(base.fit.held, model.fit.held, problem)
        reason = _forward_refusal(test, criteria)
        trace.append(Step("refused" if reason else "tried", candidate, test, reason))
        if reason is None and (best is None or beats(problem, model, best, criteria)):
            best = model
    if best is None:
        reason = step_reason("score_test", passed=len(passing), of=len(scores))
        trace.append(Step("ended", None, None, reason))
    else:
        trace.append(Step("added", best.added[-1], None, None))
    return best


def _forward_refusal(test: Test, criteria: Criteria) -> Reason | None:
    if test.gain < criteria.size:
        return step_reason("forward_gain", test.gain)
    if test.p > attainable(criteria.confidence, test.parts):
        return step_reason("forward_level", test.p)
    return None


def backward_elimination(
    problem: Problem, model: Model, criteria: Criteria, trace: list[Step], notify: Progress
) -> tuple[Model, list["LeftOut"], list[Model]]:
    """Effects that do not hold out beside all others go, the weakest first.

    Returns:
        The model of those that stay, the evidence of each, and the declared models on the way.
    """
    bare: list[Model] = []
    while True:
        rows = []
        for c in model.added:
            notify(f"without {c.name.replace('_', ' ')}")
            less = without(problem, model, c, 2 * criteria.rounds)
            rows.append(evidence(problem, model, less, c, criteria))
        bare += [e.less for e in rows if not e.less.added]
        by_p = sorted(rows, key=lambda e: e.test.p)
        levels = {
            e.candidate.name: attainable(criteria.confidence, e.test.parts, len(rows) - rank)
            for rank, e in enumerate(by_p)
        }
        rows = [replace(e, level=levels[e.candidate.name]) for e in rows]
        refused = [(e, reason) for e in rows if (reason := refusal(e)) is not None]
        if not refused:
            return model, rows, bare
        weakest, reason = min(refused, key=lambda r: r[0].test.gain)
        trace.append(Step("dropped", weakest.candidate, weakest.test, reason))
        model = weakest.less


def look_alikes(e: "LeftOut", notify: Progress) -> list[tuple[Candidate, Model]]:
    """Effects that do as well in the place of one, each with its model."""
    problem, criteria, found = e.problem, e.criteria, []
    for s in likely(problem, e.model, e.less, e.candidate):
        notify(f"{s.candidate.name.replace('_', ' ')} in its place")
        values, loss = added(problem, e.less, s, 2 * criteria.glance)
        if loss > CLOSE * e.model.fit.loss:
            continue
        other = finished(problem, (*e.less.added, s.candidate), values, 2 * criteria.rounds)
        if does_as_well(paired(other.fit.held, e.model.fit.held, problem), criteria):
            found.append((s.candidate, other))
    return found


def does_as_well(test: Test, criteria: Criteria) -> bool:
    """Whether a look-alike's model is hardly worse than that of a name; test: of the name's model
    against it.
    """
    return test.gain < criteria.gap or test.p > criteria.confidence


def likely(problem: Problem, model: Model, less: Model, gone: Candidate) -> list[Score]:
    """Effects that may do as well as what `less` lacks: one step in its place takes off a part of
    what it does.
    """
    minimum = LIKELY * (1.0 - model.fit.loss / less.fit.loss)
    known = (gone, *model.added)
    return [s for s in scored(problem, less) if s.candidate not in known and s.gain >= minimum]


def within_noise(problem: Problem, model: Model, criteria: Criteria) -> bool:
    """Whether a model leaves no more than the noise, so that it lacks nothing."""
    return model.fit.loss < criteria.quiet**2 * problem.counts.sum()


@dataclass(frozen=True)
class LeftOut(Evidence):
    """Evidence of trials that are left out: a model and `less`, the one without a candidate."""

    problem: Problem
    model: Model
    less: Model
    candidate: Candidate
    criteria: Criteria
    test: Test
    level: float
    steadiness: float

    @property
    def gain(self) -> float:
        return self.test.gain

    @property
    def price(self) -> float:
        return self.criteria.size

    @property
    def min_steadiness(self) -> float:
        return self.criteria.steady

    @property
    def at_bound(self) -> bool:
        quantities = self.problem.quantities
        for i in self.problem.at(amplitudes(self.candidate)):
            q, value = quantities[i], self.model.fit.values[i]
            ends = [z for z in (q.low, q.high) if np.isfinite(z) and z != q.neutral]
            if any(abs(value - z) <= self.criteria.bound * abs(z) for z in ends):
                return True
        return False

    @property
    def scaled_change(self) -> float:
        at = self.problem.at(self.candidate.quantities)
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
        if not self.criteria.beyond or after <= self.criteria.quiet**2:
            return None
        noise = float(self.problem.counts.sum())
        whole = _share(self.less.fit.loss, self.model.fit.loss, noise)
        return max(whole, _share(before, after, 1.0))


def evidence(
    problem: Problem, model: Model, less: Model, candidate: Candidate, criteria: Criteria
) -> LeftOut:
    """What left-out trials show of a candidate beside all others of a model."""
    test = paired(less.fit.held, model.fit.held, problem)
    steady = steadiness(problem, model, candidate)
    return LeftOut(problem, model, less, candidate, criteria, test, criteria.confidence, steady)


def _middle(problem: Problem, model: Model) -> float:
    """Median over trials of the mean square that is left."""
    return float(np.median(mean_square(problem, model.fit.residual)))


def _share(before: float, after: float, noise: float) -> float:
    return (before - after) / max(before - noise, 1e-9)


def amplitudes(c: Candidate) -> list[str]:
    """Quantities of a candidate that are no places."""
    return [q for q in c.quantities if all(q not in shape for shape in c.shapes)]


def steadiness(problem: Problem, model: Model, c: Candidate) -> float:
    """Size over scatter of the steadiest amplitude, of places where there is no other."""
    at = problem.at(amplitudes(c) or c.quantities)
    size = np.abs(model.fit.values[at] - problem.neutral[at])
    return float(np.max(size / np.maximum(spread(model)[at], 1e-12)))


def _refitted(problem: Problem, model: Model, criteria: Criteria) -> Model:
    """A model that was taken, fitted on with starts found for it."""
    if problem.anew is None:
        return model
    problem.anew(model.fit.values)
    return finished(problem, model.added, model.fit.values, criteria.rounds)


def _updated(problem: Problem, model: Model) -> Model:
    """A model as it is, with starts and weights as they are now."""
    if problem.anew is None:
        return model
    return Model(model.added, completed(problem, model.fit.free, model.fit.values))
