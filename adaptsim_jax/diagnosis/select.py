"""Which effects trials show: score tests, forward by left-out trials, each name beside all others,
look-alikes as a class.

The rules are those of `attribution.select`; trials are independent and short, so that fits are
whole ones. The variance of a score is the residual's own, times the length over which residuals
within a trial hang together.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy import stats

from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.fit import (
    Fit,
    completed,
    declared_fit,
    fitted,
    jacobian,
    mean_square,
    settled,
)
from adaptsim_jax.diagnosis.problem import Candidate, Problem
from adaptsim_jax.diagnosis.testing import Test, attainable, jackknife, paired_test

LAGS = 40  # rows over which residuals are asked whether they hang together
CLOSE = 1.5  # of the named model's loss, up to which a look-alike is fitted to the end


@dataclass(frozen=True)
class Score:
    """gain: share of the loss that one step would take off, shape by shape the best; p: of the F
    test, not yet corrected.
    """

    effect: Candidate
    shape: dict[str, float]
    gain: float
    p: float


@dataclass(frozen=True)
class Model:
    """Effects in the model and its fit."""

    added: tuple[Candidate, ...]
    fit: Fit


@dataclass(frozen=True)
class Named:
    """An effect that holds out beside all others; alternatives: effects that do as well in its
    place, and the models with them.
    """

    effect: Candidate
    test: Test
    steady: float
    alternatives: tuple[tuple[Candidate, Model], ...]


@dataclass(frozen=True)
class Selection:
    null: Model
    final: Model
    named: tuple[Named, ...]
    scores: tuple[Score, ...]
    refused: dict[str, str]


def paired(without: np.ndarray, with_: np.ndarray, problem: Problem | None = None) -> Test:
    """Whether the second model predicts trials better: mean squares `[T]` of each. Logarithms of
    the ratio are averaged over the problem's folds, and over its blocks for the test; over trials
    where it has none.
    """
    if problem is None:
        return paired_test(without, with_)
    return paired_test(without, with_, problem.fold, problem.block)


def together(problem: Problem, residual: np.ndarray) -> float:
    """Rows over which residuals hang together: the sum of their autocorrelation while it is above
    the noise, at least 1.
    """
    r = residual.reshape(len(residual), -1, problem.channels)
    power = float(np.square(r).sum())
    total = 1.0
    for lag in range(1, min(LAGS, r.shape[1] - 1)):
        rho = float((r[:, lag:] * r[:, :-lag]).sum()) / max(power, 1e-12)
        if rho < 0.05:
            break
        total += 2.0 * rho
    return total


def scored(problem: Problem, base: Model) -> list[Score]:
    """Every candidate that is not in the model, the best of its shapes, likeliest first."""
    fit = base.fit

    def flat(c):
        return c.reshape(c.shape[0] * c.shape[1], c.shape[2])

    inner, r = flat(fit.columns), fit.residual.reshape(-1)
    floor = 1e-9 * np.eye(inner.shape[1])
    gram = np.linalg.inv(inner.T @ inner + floor)
    n = float(problem.counts.sum())
    tau = together(problem, fit.residual)
    out = []
    open_ = [e for e in problem.effects if e not in base.added]
    plain = list(
        dict.fromkeys(q for e in open_ if {} in e.shapes for q in e.quantities if q not in fit.free)
    )
    if plain:
        column = dict(
            zip(plain, np.moveaxis(jacobian(problem, fit.values, plain), -1, 0), strict=True)
        )
    else:
        column = {}
    for e in open_:
        best = None
        for shape in e.shapes:
            values = begun_at(problem, fit.values, shape)
            names = [q for q in e.quantities if q not in shape and q not in fit.free]
            if set(e.quantities) <= set(fit.free):
                continue
            # of what is all shape the whole step there
            if names and not shape:
                c = flat(np.stack([column[q] for q in names], -1))
            else:
                if names:
                    c = flat(jacobian(problem, values, names))
                else:
                    c = _whole(problem, fit, values)
            c = c - inner @ (gram @ (inner.T @ c))
            a = c.T @ c
            u = c.T @ (r - inner @ (gram @ (inner.T @ r)))
            gain = float(u @ np.linalg.solve(a + (1e-6 + 1e-9 * np.trace(a)) * np.eye(len(a)), u))
            k = len(e.quantities)
            rest = max(n / tau - len(fit.free) - k, 2.0)
            ratio = (gain / k) / (
                tau * max(fit.loss - gain, 1e-9) / max(n - len(fit.free) - k, 1.0)
            )
            p = float(min(1.0, len(e.shapes) * stats.f.sf(ratio, k, rest)))
            if best is None or gain > best.gain * fit.loss:
                best = Score(e, dict(shape), gain / max(fit.loss, 1e-12), p)
        if best is not None:
            out.append(best)
    return sorted(out, key=lambda s: (s.p, -s.gain))


def _whole(problem: Problem, fit: Fit, values: np.ndarray) -> np.ndarray:
    """What `values [P]` simulate beside a fit, `[T R, 1]`."""
    return (fit.residual - problem.residuals(np.tile(values, (len(problem.trials), 1)))).reshape(
        -1, 1
    )


def begun_at(problem: Problem, values: np.ndarray, shape: Mapping[str, float]) -> np.ndarray:
    """Values `[P]` with those of a shape put in."""
    values = values.copy()
    for name, value in shape.items():
        values[problem.index[name]] = value
    return values


def added(problem: Problem, base: Model, score: Score, rounds: int) -> tuple[np.ndarray, float]:
    """The base with a candidate, fitted for so many rounds."""
    names = (*base.fit.free, *[q for q in score.effect.quantities if q not in base.fit.free])
    return fitted(problem, names, begun_at(problem, base.fit.values, score.shape), rounds)


def finished(problem: Problem, effects, values, rounds: int) -> Model:
    names = list(problem.declared)
    for e in effects:
        names += [q for q in e.quantities if q not in names]
    return Model(
        tuple(effects), completed(problem, names, settled(problem, names, values, rounds)[0])
    )


def without(problem: Problem, model: Model, gone: Candidate, rounds: int) -> Model:
    values = model.fit.values.copy()
    values[problem.at(gone.quantities)] = problem.neutral[problem.at(gone.quantities)]
    return finished(problem, [e for e in model.added if e is not gone], values, rounds)


def spread(model: Model) -> np.ndarray:
    """Standard errors `[P]` by the jackknife over trials."""
    return jackknife(np.unique(model.fit.vectors, axis=0))  # trials of one fold have the same


def steadiness(problem: Problem, model: Model, e: Candidate) -> float:
    """Size over scatter of the effect's steadiest quantity that is not a place, where there is
    another.
    """
    at = problem.at([q for q in e.quantities if all(q not in s for s in e.shapes)] or e.quantities)
    size = np.abs(model.fit.values[at] - problem.neutral[at])
    return float(np.max(size / np.maximum(spread(model)[at], 1e-12)))


def at_bound(problem: Problem, model: Model, e: Candidate, criteria: Criteria) -> bool:
    """Whether a quantity of an effect that is not a place lies at an end of its range that is not
    where it is neutral.
    """
    for i in problem.at([q for q in e.quantities if all(q not in s for s in e.shapes)]):
        q, value = problem.quantities[i], model.fit.values[i]
        ends = [z for z in (q.low, q.high) if np.isfinite(z) and z != q.neutral]
        if any(abs(value - z) <= criteria.bound * abs(z) for z in ends):
            return True
    return False


def trifling(problem: Problem, model: Model, e: Candidate, criteria: Criteria) -> bool:
    """Whether all that an effect does is to change numbers of the model by less than what matters
    of them.
    """
    at = problem.at(e.quantities)
    scale = np.array([problem.quantities[i].scale for i in at])
    return bool(
        np.all(np.abs(model.fit.values[at] - problem.neutral[at]) < criteria.matters * scale)
    )


def select(
    problem: Problem,
    criteria: Criteria,
    say: Callable[[str], None] = lambda note: None,
    alike: bool = True,
    keep: Callable[[Selection], None] = lambda found: None,
) -> Selection:
    """Forward, then each beside the others, then against its look-alikes (not with `alike` false).
    keep: told of what is found, as it goes.
    """
    say("declared model")
    base = null = Model((), declared_fit(problem, 3 * criteria.rounds, criteria.quiet**2 or np.inf))
    opening = scores = scored(problem, base)
    refused: dict[str, str] = {}
    keep(Selection(null, base, (), tuple(opening), refused))
    while len(base.added) < criteria.most_effects and not quiet(problem, base, criteria):
        better = _forward(problem, base, scores, criteria, refused, say)
        if better is None:
            break
        base, null = _anew(problem, better, criteria), _again(problem, null)
        keep(Selection(null, base, (), tuple(opening), refused))
        scores = scored(problem, base)
    final, named, bare = _judged(problem, base, criteria, refused, say, alike)
    # a declared fit reached by way of an effect may lie in a better minimum than the first
    null = min((null, *bare), key=lambda m: m.fit.loss)
    if named:
        final, null = _anew(problem, final, criteria), _again(problem, null)
    return Selection(null, final, named, tuple(opening), refused)


def _anew(problem: Problem, model: Model, criteria: Criteria) -> Model:
    """A model that was taken, fitted on with starts found anew."""
    if problem.anew is None:
        return model
    problem.anew(model.fit.values)
    return finished(problem, model.added, model.fit.values, criteria.rounds)


def _again(problem: Problem, model: Model) -> Model:
    """A model as it is, with starts and weights as they are now."""
    if problem.anew is None:
        return model
    return Model(model.added, completed(problem, model.fit.free, model.fit.values))


def _forward(problem, base: Model, scores, criteria: Criteria, refused, say) -> Model | None:
    family = max(len(scores), 1)
    hopeful = sorted((s for s in scores if s.p * family < criteria.alpha), key=lambda s: -s.gain)
    tries = []
    for s in hopeful[: criteria.tried]:
        say(s.effect.name.replace("_", " "))
        tries.append((*added(problem, base, s, criteria.glance), s))
    tries.sort(key=lambda t: t[1])
    best = None
    for values, loss, s in tries[: criteria.tried // 2]:
        if best is not None and loss > (1.0 + criteria.behind) * tries[0][1]:
            break
        model = finished(problem, (*base.added, s.effect), values, criteria.rounds)
        test = paired(base.fit.held, model.fit.held, problem)
        if test.gain < criteria.size or test.p > _level(criteria, test.parts):
            refused[s.effect.name] = f"held-out gain {100 * test.gain:.1f} %, p {test.p:.2g}"
            continue
        if best is None or beats(problem, model, best, criteria):
            best = model
    return best


def _level(criteria: Criteria, folds: int, family: int = 1) -> float:
    """The level of a paired test, one of `family`: at least what so few trials can show, all of
    them better.
    """
    return attainable(criteria.confidence, folds, family)


def beats(problem: Problem, model: Model, other: Model, criteria: Criteria) -> bool:
    """Whether a model is to be taken instead of another: the one with fewer quantities, unless the
    larger holds out better; among equals the better.
    """
    if len(model.fit.free) == len(other.fit.free):
        return paired(other.fit.held, model.fit.held, problem).gain > 0.0
    small, large = sorted((other, model), key=lambda m: len(m.fit.free))
    test = paired(small.fit.held, large.fit.held, problem)
    return (large if test.gain > criteria.size and test.p < criteria.confidence else small) is model


def quiet(problem: Problem, model: Model, criteria: Criteria) -> bool:
    """Whether a model leaves no more than the noise, so that it lacks nothing."""
    return model.fit.loss < criteria.quiet**2 * problem.counts.sum()


def beyond(problem: Problem, less: Model, model: Model, criteria: Criteria) -> float:
    """Share that an effect takes off of the squared error beyond the noise that `less`, the model
    without it, leaves: of the sum or of the median over trials, the larger. 1 where the model
    leaves next to nothing, and where this is not asked.

    A body that moves by other laws than the model's is followed better by any effect that resembles
    the difference.
    """

    def middle(m):
        return float(np.median(mean_square(problem, m.fit.residual)))

    if not criteria.beyond or middle(model) <= criteria.quiet**2:
        return 1.0
    noise = float(problem.counts.sum())

    def share(before, after, floor):
        return (before - after) / max(before - floor, 1e-9)

    return max(share(less.fit.loss, model.fit.loss, noise), share(middle(less), middle(model), 1.0))


def _judged(problem, model: Model, criteria: Criteria, refused, say, alike: bool):
    """The model of what holds out, its effects as named, and the declared models that it was
    compared with.
    """
    bare = []
    while True:
        tests = []
        for e in model.added:
            say(f"without {e.name.replace('_', ' ')}")
            less = without(problem, model, e, 2 * criteria.rounds)
            bare += [less] * (not less.added)
            tests.append(
                (
                    e,
                    less,
                    paired(less.fit.held, model.fit.held, problem),
                    steadiness(problem, model, e),
                )
            )
        failing = []
        for rank, (e, less, test, steady) in enumerate(sorted(tests, key=lambda t: t[2].p)):
            if (
                test.p > _level(criteria, test.parts, len(tests) - rank)
                or test.gain < criteria.size
                or steady < criteria.steady
                or at_bound(problem, model, e, criteria)
                or trifling(problem, model, e, criteria)
                or quiet(problem, less, criteria)
                or beyond(problem, less, model, criteria) < criteria.beyond
            ):
                failing.append((test.gain, e, less, test, steady))
        if not failing:
            break
        _, e, less, test, steady = min(failing, key=lambda f: f[0])
        refused[e.name] = (
            f"dropped: held-out gain {100 * test.gain:.1f} %, p {test.p:.2g}, size over scatter "
            f"{steady:.1f}, "
            f"{100 * beyond(problem, less, model, criteria):.0f} % of what is beyond the noise"
            f"{', its value is at its bound: widen the range' * at_bound(problem, model, e, criteria)}"
            f"{', it changes less than what matters' * trifling(problem, model, e, criteria)}"
        )
        model = less
    named = tuple(
        Named(
            e, test, steady, _look_alikes(problem, model, less, e, criteria, say) if alike else ()
        )
        for e, less, test, steady in tests
    )
    return model, named, bare


def likely(problem: Problem, model: Model, less: Model, e: Candidate) -> list[Score]:
    """Effects that may do as well as `e`, which `less` lacks: one step in its place takes off a
    tenth of what it does.
    """
    least = 0.1 * (1.0 - model.fit.loss / less.fit.loss)
    return [
        s for s in scored(problem, less) if s.effect not in (e, *model.added) and s.gain >= least
    ]


def _look_alikes(problem, model: Model, less: Model, e: Candidate, criteria: Criteria, say):
    """Effects that do as well in the place of `e`, with their models."""
    found = []
    for s in likely(problem, model, less, e):
        say(f"{s.effect.name.replace('_', ' ')} in its place")
        values, loss = added(problem, less, s, 2 * criteria.glance)
        if loss > CLOSE * model.fit.loss:
            continue
        other = finished(problem, (*less.added, s.effect), values, 2 * criteria.rounds)
        test = paired(other.fit.held, model.fit.held, problem)
        if test.gain < criteria.gap or test.p > criteria.confidence:
            found.append((s.effect, other))
    return tuple(found)
