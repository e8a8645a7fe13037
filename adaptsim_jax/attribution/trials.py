"""Attribution over short trials that each begin anew from a known state: pushes, scoops, tosses.

One flat vector holds the declared parameters and those of every effect (at the value where it does nothing); a model is a part of it
that is fitted. Everything else is as for mechanisms (`docs/attribution.md`): score tests over clusters, here trials; an effect stays
if without it left-out trials are predicted worse; look-alikes are told as a class.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from adaptsim_jax.attribution.criteria import Criteria
from adaptsim_jax.attribution.select import Test, sign_flip

Residuals = Callable[[np.ndarray], np.ndarray]
ROUNDS = 25
STILL = 1e-7  # share of the loss below whose fall a fit has converged


@dataclass(frozen=True)
class Parameter:
    """A number of the vector: off, the value at which it does nothing (declared ones: where the fit begins); bounds; unit."""

    name: str
    unit: str
    off: float
    low: float
    high: float


@dataclass(frozen=True)
class Candidate:
    """An effect: the parameters that it fits, and the values (one for each) from which fits begin."""

    name: str
    place: str
    parameters: tuple[str, ...]
    starts: tuple[tuple[float, ...], ...]
    physics: str
    excited_by: str


@dataclass(frozen=True)
class Problem:
    """residuals(vectors [N, P]) -> [N, R] of N trials, each at its own vector, in units of the noise; slopes(vector [P], which) ->
    ([N, R], [N, R, len(which)]); declared: names that are always fitted; trials: their names; starts [S, P]: vectors from
    the best of which the declared model's fit begins."""

    parameters: tuple[Parameter, ...]
    candidates: tuple[Candidate, ...]
    declared: tuple[str, ...]
    residuals: Residuals
    slopes: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
    trials: tuple[str, ...]
    starts: np.ndarray

    @property
    def off(self) -> np.ndarray:
        return np.array([p.off for p in self.parameters])

    def at(self, names: Sequence[str]) -> np.ndarray:
        known = [p.name for p in self.parameters]
        return np.array([known.index(n) for n in names], int)

    def everywhere(self, vector: np.ndarray) -> np.ndarray:
        return np.repeat(vector[None], len(self.trials), 0)


@dataclass(frozen=True)
class Model:
    """A subset fitted. vector [P]; free: indices; residual [N, R] and slopes [N, R, free] there; held [N]: left-out loss by trial,
    folds [N, P]: vectors without it; weight [N]: trials that run away count less."""

    added: tuple[Candidate, ...]
    vector: np.ndarray
    free: np.ndarray
    residual: np.ndarray
    slopes: np.ndarray
    weight: np.ndarray
    held: np.ndarray
    folds: np.ndarray

    @property
    def loss(self) -> float:
        return float(_loss(self.residual, self.weight).sum())


@dataclass(frozen=True)
class Named:
    candidate: Candidate
    test: Test
    alternatives: tuple[Candidate, ...]
    steady: float


@dataclass(frozen=True)
class Selection:
    null: Model
    final: Model
    stages: tuple[Model, ...]
    named: tuple[Named, ...]
    first: tuple[
        tuple[Candidate, float, float], ...
    ]  # candidate, share of the loss that it gains at first order, robust p
    dropped: tuple[str, ...]


def _loss(residual: np.ndarray, weight: np.ndarray) -> np.ndarray:
    return 0.5 * weight * np.square(residual).sum(-1)


def _step(hess, slope, low, high, damping):
    """Damped step within bounds: what pushes against one stays."""
    free, step = np.ones(len(slope), bool), np.zeros(len(slope))
    size = np.sqrt(np.maximum(np.diag(hess), 1e-12))
    for _ in range(len(slope) + 1):
        if not free.any():
            break
        a = hess[np.ix_(free, free)] / np.outer(size[free], size[free])
        a[np.diag_indices_from(a)] += damping + 1e-9
        right = (slope - hess @ np.where(free, 0.0, step))[free] / size[free]
        step[free] = np.linalg.solve(a, right) / size[free]
        out = free & ((step < low) | (step > high))
        if not out.any():
            break
        step[out] = np.clip(step[out], low[out], high[out])
        free &= ~out
    return step


def fit(problem: Problem, added: Sequence[Candidate], start: np.ndarray, weight: np.ndarray | None = None) -> Model:
    """Bounded Gauss and Newton's steps (Levenberg and Marquardt's damping) from `start` [P]."""
    names = [*problem.declared, *dict.fromkeys(n for c in added for n in c.parameters)]
    free = problem.at(names)
    low = np.array([problem.parameters[i].low for i in free])
    high = np.array([problem.parameters[i].high for i in free])
    vector, damping = np.array(start, float), 1e-3
    vector[free] = np.clip(vector[free], low, high)
    residual, slopes = problem.slopes(vector, free)
    own = weight is None
    weight = _weights(residual) if own else weight
    for _ in range(ROUNDS):
        now = _loss(residual, weight).sum()
        j = slopes * np.sqrt(weight)[:, None, None]
        flat = j.reshape(-1, len(free))
        r = (residual * np.sqrt(weight)[:, None]).reshape(-1)
        hess, slope = flat.T @ flat, -flat.T @ r
        for _ in range(8):
            step = _step(hess, slope, low - vector[free], high - vector[free], damping)
            trial = vector.copy()
            trial[free] += step
            loss = _loss(problem.residuals(problem.everywhere(trial)), weight).sum()
            if loss < now:
                break
            damping *= 10.0
        else:
            break
        vector, damping = trial, max(0.1 * damping, 1e-9)
        residual, slopes = problem.slopes(vector, free)
        if own:
            weight = _weights(residual)
        if loss > now * (1.0 - STILL):
            break
    held, folds = _left_out(problem, vector, free, residual, slopes, weight, low, high)
    return Model(tuple(added), vector, free, residual, slopes, weight, held, folds)


def _weights(residual: np.ndarray) -> np.ndarray:
    size = np.sqrt(np.square(residual).mean(1))
    return 1.0 / np.square(np.maximum(1.0, size / (3.0 * max(float(np.median(size)), 1e-12))))


def _left_out(problem, vector, free, residual, slopes, weight, low, high):
    """Each trial predicted with the parameters of the others: a step from the whole fit without its share of the normal equations."""
    j = slopes * np.sqrt(weight)[:, None, None]
    r = residual * np.sqrt(weight)[:, None]
    hess = np.einsum("nra,nrb->nab", j, j)
    slope = -np.einsum("nra,nr->na", j, r)
    whole = _step(hess.sum(0), slope.sum(0), low - vector[free], high - vector[free], 0.0)
    folds = problem.everywhere(vector)
    for k in range(len(folds)):
        step = _step(hess.sum(0) - hess[k], slope.sum(0) - slope[k], low - vector[free], high - vector[free], 0.0)
        folds[k, free] = np.clip(vector[free] + step - whole, low, high)
    return _loss(problem.residuals(folds), weight), folds


def paired(without: Model, with_: Model) -> Test:
    """Left-out trial by trial: is the second better?"""
    usual = 0.1 * np.median(without.held)
    d = np.log((without.held + usual) / (with_.held + usual))
    return Test(1.0 - float(np.exp(-d.mean())), sign_flip(d), int((d > 0).sum()), len(d))


def scores(problem: Problem, model: Model) -> list[tuple[Candidate, float, float]]:
    """First-order gain of each candidate as a share of the loss, and the robust p of its score, best first."""
    weight = np.sqrt(model.weight)[:, None]
    r = (model.residual * weight).reshape(-1)
    base = (model.slopes * weight[..., None]).reshape(len(r), -1)
    scale = np.sqrt(np.square(base).sum(0))
    q, _ = np.linalg.qr(base[:, scale > 0] / scale[scale > 0])
    r = r - q @ (q.T @ r)
    out, count = [], len(problem.trials)
    every = np.array([i for i in range(len(problem.parameters)) if i not in set(model.free)])
    slopes = np.zeros((*model.residual.shape, len(problem.parameters)))
    slopes[:, :, every] = problem.slopes(model.vector, every)[1]
    for c in problem.candidates:
        if any(set(c.parameters) & set(a.parameters) for a in model.added):
            continue
        best = None
        for start in c.starts:
            columns = _columns(problem, model, slopes, c, start) * weight[..., None]
            flat = columns.reshape(len(r), -1)
            flat = flat - q @ (q.T @ flat)
            bend = flat.T @ flat
            if np.min(np.diag(bend)) < 1e-9:
                continue
            amplitude = np.linalg.lstsq(bend, -flat.T @ r, rcond=1e-10)[0]
            gain = float(-amplitude @ (flat.T @ r) - 0.5 * amplitude @ bend @ amplitude)
            each = (flat * r[:, None]).reshape(count, -1, flat.shape[1]).sum(1)
            spread = np.sqrt(np.maximum(each.var(0), 0.0) / (count - 1))
            t = np.abs(each.mean(0)) / np.maximum(spread, 1e-300)
            z = stats.norm.isf(np.maximum(stats.t.sf(t, count - 1), 1e-300))
            p = float(stats.chi2.sf(np.square(z).sum(), len(z)))
            if best is None or gain > best[1]:
                best = (replace(c, starts=(start,)), gain / max(model.loss, 1e-300), p)
        if best is not None:
            out.append(best)
    return sorted(out, key=lambda s: -s[1])


def _columns(problem: Problem, model: Model, slopes: np.ndarray, c: Candidate, start: tuple[float, ...]) -> np.ndarray:
    """[N, R, K] slopes by the parameters of a candidate: at the model where it starts from nothing, else of the step to its start."""
    at = problem.at(c.parameters)
    if np.allclose(start, problem.off[at]):
        return slopes[:, :, at]
    vector = model.vector.copy()
    vector[at] = start
    return (problem.residuals(problem.everywhere(vector)) - model.residual)[..., None]


def added(problem: Problem, model: Model, c: Candidate) -> Model:
    """The model with an effect more, from each of its starts, the best of them."""
    best = None
    for start in c.starts:
        vector = model.vector.copy()
        vector[problem.at(c.parameters)] = start
        made = fit(problem, (*model.added, c), vector, model.weight)
        best = made if best is None or made.loss < best.loss else best
    assert best is not None
    return best


def without(problem: Problem, model: Model, c: Candidate) -> Model:
    """The model without one of its effects, refitted under the same weights."""
    rest = tuple(a for a in model.added if a.name != c.name)
    kept = {n for a in rest for n in a.parameters}
    vector = model.vector.copy()
    gone = problem.at([n for n in c.parameters if n not in kept])
    vector[gone] = problem.off[gone]
    return fit(problem, rest, vector, model.weight)


def declared_fit(problem: Problem, most: int = 3) -> Model:
    """The declared model fitted from the best few of the problem's starts, the best of these."""
    typical = [
        float(np.median(np.sqrt(np.square(problem.residuals(problem.everywhere(v))).mean(1)))) for v in problem.starts
    ]
    made = [fit(problem, (), problem.starts[k]) for k in np.argsort(typical)[:most]]
    return min(made, key=lambda m: float(np.median(np.square(m.residual).mean(1))))


def select(problem: Problem, criteria: Criteria, say: Callable[[str], None] = lambda note: None) -> Selection:
    """Forward, then each effect beside the others (Holm), then against its look-alikes."""
    base = null = declared_fit(problem)
    stages, opening, dropped = [null], None, []
    while len(base.added) < criteria.most_effects:
        rows = scores(problem, base)
        opening = rows if opening is None else opening
        hopeful = [s for s in rows if s[2] * len(rows) < criteria.alpha and s[1] > 0.5 * criteria.size]
        tries = []
        for c, _, _ in hopeful[: criteria.tried_short]:
            say(c.name)
            tries.append(added(problem, base, c))
        good = [m for m in tries if _holds(paired(base, m), criteria)]
        if not good:
            break
        better = _simplest(good, criteria)
        base = fit(problem, better.added, better.vector)
        stages.append(base)
    while base.added:
        tests = []
        for c in base.added:
            less = without(problem, base, c)
            tests.append((c, less, paired(less, base), _steady(problem, base, c)))
        order = sorted(tests, key=lambda t: t[2].p)
        failing = [
            t for k, t in enumerate(order)
            if t[2].p > max(criteria.confidence / (len(order) - k), 1.01 * 2.0 ** -t[2].folds)
            or t[2].gain < criteria.size or t[3] < criteria.steady
        ]  # fmt: skip
        if not failing:
            named = tuple(Named(c, t, _alike(problem, base, less, c, criteria, say), s) for c, less, t, s in tests)
            return Selection(null, base, tuple(stages), named, tuple(opening or ()), tuple(dropped))
        c, less, test, _ = min(failing, key=lambda t: t[2].gain)
        dropped.append(
            f"{c.name.replace('_', ' ')} helped at first, but does not hold out beside the others (p {test.p:.2g})"
        )
        base = fit(problem, less.added, less.vector)
    return Selection(null, base, tuple(stages), (), tuple(opening or ()), tuple(dropped))


def _holds(test: Test, criteria: Criteria) -> bool:
    return test.gain > criteria.size and test.p < criteria.confidence


def _simplest(models: Sequence[Model], criteria: Criteria) -> Model:
    """Of models of one size the one that predicts best; a larger one only where it holds out beside the smaller."""
    chosen = None
    for size in sorted({len(m.free) for m in models}):
        best = min((m for m in models if len(m.free) == size), key=lambda m: m.held.sum())
        if chosen is None or _holds(paired(chosen, best), criteria):
            chosen = best
    assert chosen is not None
    return chosen


def _steady(problem: Problem, model: Model, c: Candidate) -> float:
    at = problem.at(c.parameters)
    n = len(model.folds)
    scatter = np.sqrt((n - 1) / n * np.square(model.folds[:, at] - model.folds[:, at].mean(0)).sum(0))
    return float(np.max(np.abs(model.vector[at] - problem.off[at]) / np.maximum(scatter, 1e-12)))


def _alike(problem, model: Model, less: Model, c: Candidate, criteria: Criteria, say) -> tuple[Candidate, ...]:
    """Effects that do as well in its place, of those that gain most without it."""
    rows = scores(problem, less)
    own = next((s[1] for s in rows if s[0].name == c.name), 0.0)
    out = []
    for rival, gain, _ in rows:
        if rival.name == c.name or gain < 0.5 * own or len(out) >= 4:
            continue
        say(f"{rival.name} in place of {c.name}")
        other = added(problem, less, rival)
        test = paired(other, model)
        if test.gain < criteria.gap or test.p > criteria.confidence:
            out.append(rival)
    return tuple(out)


def spread(model: Model) -> np.ndarray:
    """Standard errors [P] by the jackknife over trials."""
    n = len(model.folds)
    return np.sqrt((n - 1) / n * np.square(model.folds - model.folds.mean(0)).sum(0))
