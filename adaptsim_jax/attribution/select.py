"""Which effects: forward selection by left-out trials, each name then tested beside all others and against its look-alikes.

Every step that chooses looks at folds (trials) that were left out of the parameters with which they are predicted. Parameters of
a fold come from the normal equations without it, one step from the whole fit (exact for a linear model; the infinitesimal jackknife
otherwise), and the prediction is simulated, with starts fitted to the fold's own stretches by plain least squares.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from adaptsim_jax.attribution.criteria import Criteria
from adaptsim_jax.attribution.estimate import (
    Fit,
    Linear,
    Weights,
    bounded_step,
    candidate_columns,
    fit,
    linear,
    losses,
    normal,
    padded_fold,
    residuals,
    run,
    settled,
    start_steps,
)
from adaptsim_jax.attribution.parameters import TILT, Vector
from adaptsim_jax.attribution.problem import Problem, blocks_of, own_inertia, scaled_reach
from adaptsim_jax.attribution.score import Candidate, Score, candidates, shape_entries, table
from adaptsim_jax.attribution.stays import steadiness, why_not
from adaptsim_jax.effects.base import Reach

BLOCKS = 24  # of consecutive stretches, about, whose losses a paired test compares
EXACT = 14  # parts up to which the sign-flip test takes all patterns of signs


@dataclass(frozen=True)
class HeldOut:
    """Prediction of left-out folds: loss [W] under given weights, squared error [W, 2n] (mean over a stretch), parameters [F, P]."""

    loss: np.ndarray
    squared: np.ndarray
    vectors: np.ndarray


@dataclass(frozen=True)
class Model:
    """A set of effects fitted, its linearisation and its held-out prediction."""

    added: tuple[Candidate, ...]
    fit: Fit
    lin: Linear
    held: HeldOut

    @property
    def spread(self) -> np.ndarray:
        """Standard errors [P] by the jackknife over folds."""
        v = self.held.vectors
        return np.sqrt((len(v) - 1) / len(v) * np.square(v - v.mean(0)).sum(0))


@dataclass(frozen=True)
class Test:
    """Of one model against another. gain: the share of the loss that it takes off (geometric mean over folds); p of a sign-flip test
    over `parts` blocks; better: folds in which it is better."""

    gain: float
    p: float
    better: int
    folds: int
    parts: int


@dataclass(frozen=True)
class Step:
    """What the search did: action (added, refused, dropped, replaced, ended), candidate, its test, why."""

    action: str
    candidate: Candidate | None
    score: Score | None
    test: Test | None
    why: str


@dataclass(frozen=True)
class Named:
    """An effect that holds out. test: beside all others; alternatives: effects that do as well in its place; z: size over scatter."""

    candidate: Candidate
    test: Test
    alternatives: tuple[Candidate, ...]
    steady: float
    p: float


@dataclass(frozen=True)
class Selection:
    """What a search found. null: the declared model; stages: (model, added) in turn; final; trace; scores at the declared model and
    at the final one."""

    null: Model
    final: Model
    named: tuple[Named, ...]
    stages: tuple[Model, ...]
    trace: tuple[Step, ...]
    first: tuple[Score, ...]
    last: tuple[Score, ...]
    reach: Reach


def held_out(problem: Problem, lin: Linear, weights: Weights | None = None) -> HeldOut:
    """Each fold predicted with parameters from the others."""
    now = lin.fit
    weights = now.weights if weights is None else weights
    n = normal(problem, lin.residual, lin.start, lin.shared)
    hess, vector = n.hess.sum(0), now.vector
    inside = (vector.values > vector.low) & (vector.values < vector.high)
    # one step from the fit, which is taken for the best there is (a step that gained nothing, where dry friction bends the loss, no
    # fold takes either), or for what its slope says of it (a fit that a kink has stopped short): of both the shorter one
    at_best = np.where(inside, vector.precision * (vector.values - vector.start), n.slope.sum(0))
    without = lambda slope: [
        bounded_step(hess - h, slope - s, vector, 1e-9) for h, s in zip(n.hess, n.slope, strict=True)
    ]
    both = np.array([without(slope) for slope in (at_best, n.slope.sum(0))])
    length = np.einsum("mfp,pq,mfq->mf", both, hess + np.diag(vector.precision), both)
    steps = both[np.argmin(length, 0), np.arange(len(n.hess))]
    fold = padded_fold(problem, len(now.loss))
    rows = np.where(fold[:, None] >= 0, now.vector.values + steps[np.maximum(fold, 0)], now.vector.values)
    starts = [x + d for x, d in zip(now.starts, start_steps(lin, rows - now.vector.values), strict=True)]
    _, _, kept = settled(problem, lin, now.vector, (starts, now.starts), rows, refine=2)
    loss = losses(problem, kept, weights)
    width, joints = len(loss), problem.joints
    squared = np.zeros((width, 2 * joints))
    for group, path in zip(problem.groups, kept, strict=True):
        r = residuals(group, path)
        seen = np.concatenate([group.stretches.seen, group.stretches.seen_v], 1).transpose(2, 0, 1).sum(1)
        j = np.array(group.joints)
        squared[:, [*j, *(joints + j)]] = np.square(r).sum(1) / np.maximum(seen, 1)
    return HeldOut(loss, squared, now.vector.values + steps)


def paired(problem: Problem, without: np.ndarray, with_: np.ndarray) -> Test:
    """One model against another by their held-out losses [W] (one-sided: is the second better?): logarithms of each stretch's ratio,
    averaged over a fold or a block, so that no stretch that runs away decides for its trial. The test takes blocks of consecutive
    stretches: a few trials alone could not show what is not in each of them."""
    a, b = without[: len(problem.fold)], with_[: len(problem.fold)]
    usual = 0.1 * np.median(a)  # a unit that hardly moved says little, however much it gained
    ratio = np.log((a + usual) / (b + usual))
    mean = lambda unit: np.bincount(unit, ratio) / np.bincount(unit)
    d, parts = mean(problem.fold), mean(blocks_of(problem.groups[0].stretches.trial[: len(ratio)], BLOCKS))
    return Test(1.0 - float(np.exp(-d.mean())), sign_flip(parts), int((d > 0).sum()), len(d), len(parts))


def sign_flip(d: np.ndarray) -> float:
    """One-sided p of the mean of paired differences [F] under random signs (Fisher's permutation test): all patterns, or 20,000."""
    count = len(d)
    if count <= EXACT:
        signs = 1.0 - 2.0 * ((np.arange(2**count)[:, None] >> np.arange(count)) & 1)
    else:
        signs = np.random.default_rng(0).choice([-1.0, 1.0], (10_000, count))
        signs[0] = 1.0
    return float(np.mean(signs @ d >= d.sum() * (1.0 - 1e-12)))


def modelled(problem: Problem, added: Sequence[Candidate], fitted: Fit, weights: Weights | None = None) -> Model:
    lin = linear(problem, fitted)
    return Model(tuple(added), fitted, lin, held_out(problem, lin, weights))


def refit(
    problem: Problem, base: Fit, vector: Vector, starts, joints: Sequence[int], rounds: int, weights: Weights | None
) -> Fit:
    """A fit after something changed at `joints`: only in the groups of joints that this touches, where no value is shared."""
    touched = [k for k, g in enumerate(problem.groups) if set(g.joints) & set(joints)]
    owner = {j: k for k, g in enumerate(problem.groups) for j in g.joints}
    shared = any(len({owner[j] for j in e.joints}) > 1 for e in vector.entries)
    if shared or weights is None or len(touched) == len(problem.groups):
        return fit(problem, vector, starts, rounds=rounds, weights=weights)
    part = replace(problem, groups=tuple(problem.groups[k] for k in touched))
    inside = {j for k in touched for j in problem.groups[k].joints}
    at = [i for i, e in enumerate(vector.entries) if set(e.joints) <= inside]
    local = fit(
        part,
        Vector(tuple(vector.entries[i] for i in at), vector.values[at]),
        [starts[k] for k in touched],
        rounds=rounds,
        weights=weights,
    )
    values, starts = vector.values.copy(), list(starts)
    values[at] = local.vector.values
    for k, x in zip(touched, local.starts, strict=True):
        starts[k] = x
    whole = vector.at(values)
    loss = losses(problem, run(problem, whole, starts), weights)
    return replace(local, vector=whole, starts=tuple(starts), loss=loss)


def attempted(
    problem: Problem, base: Model, reach: Reach, score: Score
) -> tuple[Vector, tuple[np.ndarray, ...], float]:
    """The base with a candidate added, one step on: vector, starts, and loss of the best of a few lengths of the step."""
    c = score.candidate
    columns = candidate_columns(problem, base.lin, [(e, c.shaped()) for e in c.entries])
    wide = replace(
        base.lin, shared=tuple(np.concatenate([s, k], 2) for s, k in zip(base.lin.shared, columns, strict=True))
    )
    vector = base.fit.vector.with_entries(c.entries)
    n = normal(problem, wide.residual, wide.start, wide.shared)
    step = bounded_step(n.hess.sum(0), n.slope.sum(0), vector, 1e-6)
    shapes = shape_entries(problem, reach, c)
    best = None
    for length in (1.0, 0.5, 0.2):
        moved = [x + d for x, d in zip(base.fit.starts, start_steps(wide, length * step), strict=True)]
        trial = vector.at(vector.values + length * step).with_entries(shapes)
        starts, by_lane, _ = settled(problem, base.lin, trial, (moved, base.fit.starts))
        loss = by_lane.sum()
        if best is None or loss < best[2]:
            best = (trial, starts, float(loss))
        if loss < 0.9 * base.fit.total:
            break
    return best


def select(
    problem: Problem, null: Vector, criteria: Criteria, say: Callable[[str], None] = lambda note: None
) -> Selection:
    """Forward, then each effect beside the others, then against its look-alikes."""
    fitted = fit(problem, null, rounds=15)
    reach = scaled_reach(problem, *own_inertia(problem, fitted.vector))
    base = first = modelled(problem, (), fitted)
    trace: list[Step] = []
    stages = [first]
    scores = opening = table(problem, base.lin, candidates(problem, base.fit.vector, reach))
    while len(base.added) < criteria.most_effects:
        better = _forward(problem, base, scores, reach, criteria, trace, say)
        if better is None:
            break
        base = better
        stages.append(base)
        scores = table(problem, base.lin, candidates(problem, base.fit.vector, reach))
    final, named = judged(problem, base, reach, criteria, trace, say)
    return Selection(first, final, named, tuple(stages), tuple(trace), tuple(opening), tuple(scores), reach)


def _forward(problem, base: Model, scores, reach, criteria: Criteria, trace, say) -> Model | None:
    """The best candidate that gains held out, fitted; None where none does."""
    family = max(len(scores), 1)
    hopeful = [s for s in scores if s.p * family < criteria.alpha and s.held_out > 0.5 * criteria.size * base.fit.total]
    best, weights = None, base.fit.weights
    begun = [(score, *attempted(problem, base, reach, score)) for score in hopeful[: 2 * criteria.tried]]
    for score, vector, starts, _ in sorted(begun, key=lambda b: b[3])[: criteria.tried]:
        say(f"{score.candidate.effect} at {_where(problem, score.candidate)}")
        whole = refit(problem, base.fit, vector, starts, score.candidate.joints, 2 * criteria.glance, weights)
        model = modelled(problem, (*base.added, score.candidate), whole, weights)
        test = paired(problem, base.held.loss, model.held.loss)
        good = test.gain > criteria.size and test.better > 0.5 * test.folds
        trace.append(
            Step(
                "tried" if good else "refused",
                score.candidate,
                score,
                test,
                f"fitted, leaves {whole.total / base.fit.total:.2f} of the loss",
            )
        )
        if good and (best is None or _beats(problem, model, best[1], criteria)):
            best = (test.gain, model, score, test)
    if best is None:
        trace.append(
            Step(
                "ended", None, None, None, f"{len(hopeful)} of {family} candidates pass the score test, none holds out"
            )
        )
        return None
    _, model, score, test = best
    trace.append(Step("added", score.candidate, score, test, ""))
    # its own weights from here on: the residual has become smaller, and with it what matters in it
    again = fit(problem, model.fit.vector, model.fit.starts, rounds=criteria.rounds)
    return modelled(problem, model.added, again)


def _beats(problem: Problem, model: Model, other: Model, criteria: Criteria) -> bool:
    """Whether a model is to be taken instead of another: the one with fewer parameters, unless the larger holds out better."""
    small, large = sorted((other, model), key=lambda m: len(m.fit.vector))
    test = paired(problem, small.held.loss, large.held.loss)
    chosen = large if test.gain > criteria.size and test.p < criteria.confidence else small
    return chosen is model


def without(problem: Problem, model: Model, gone: Candidate, rounds: int) -> Model:
    """The model without one of its effects, refitted under the same weights."""
    keys = [e.key for e in model.fit.vector.entries if e.owner == gone.effect and set(e.joints) <= set(gone.joints)]
    vector = model.fit.vector.without(keys)
    fitted = refit(problem, model.fit, vector, model.fit.starts, gone.joints, rounds, model.fit.weights)
    return modelled(problem, [c for c in model.added if c is not gone], fitted, model.fit.weights)


def judged(problem, model: Model, reach, criteria: Criteria, trace, say) -> tuple[Model, tuple[Named, ...]]:
    """Backward: effects that do not hold out beside the others go, the weakest first; the rest against their look-alikes."""
    while True:
        tests = []
        for c in model.added:
            say(f"without {c.effect} at {_where(problem, c)}")
            less = without(problem, model, c, criteria.rounds)
            tests.append((c, less, paired(problem, less.held.loss, model.held.loss), steadiness(problem, model, c)))
        failing = []
        for c, less, test, steady in tests:
            if why := why_not(problem, model, less, c, test, steady, criteria):
                failing.append((test.gain, c, less, test, why))
        if not failing:
            break
        _, c, less, test, why = min(failing, key=lambda f: f[0])
        trace.append(Step("dropped", c, None, test, why))
        own = fit(problem, less.fit.vector, less.fit.starts, rounds=criteria.rounds)
        model = modelled(problem, less.added, own)
    named = tuple(
        Named(c, test, look_alikes(problem, model, less, c, reach, criteria, say), steady, test.p)
        for c, less, test, steady in tests
    )
    return model, named


def look_alikes(
    problem, model: Model, less: Model, c: Candidate, reach, criteria: Criteria, say
) -> tuple[Candidate, ...]:
    """Effects that do as well as `c` in its place: of those that gain most without it, and of those that it is mistaken for."""
    scores = table(problem, less.lin, candidates(problem, less.fit.vector, reach))
    own = next((s.held_out for s in scores if s.candidate.key == c.key), 0.0)
    alike = problem.effect(c.effect).look_alikes
    rivals = [
        s for s in scores
        if s.candidate.key != c.key and not (s.candidate.effect == c.effect and set(c.joints) & set(s.candidate.joints))
        and s.held_out > (0.5 if s.candidate.effect in alike else 0.8) * own
    ]  # fmt: skip
    out = []
    for score in rivals[:3]:
        say(f"{score.candidate.effect} in place of {c.effect}")
        vector, starts, _ = attempted(problem, less, reach, score)
        fitted = refit(
            problem, less.fit, vector, starts, (*c.joints, *score.candidate.joints), criteria.rounds, model.fit.weights
        )
        other = modelled(problem, (*less.added, score.candidate), fitted, model.fit.weights)
        test = paired(problem, other.held.loss, model.held.loss)
        if test.gain < criteria.gap or test.p > criteria.confidence:
            out.append(score.candidate)
    return tuple(out)


def _where(problem: Problem, c: Candidate) -> str:
    return "base" if c.effect == TILT else ", ".join(problem.joint_names[j] for j in c.joints)
