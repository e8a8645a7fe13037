"""Which effects: forward selection by left-out trials, each name then tested beside all others and
against its look-alikes.

Every step that chooses looks at folds (trials) that were left out of the parameters with which they
are predicted (`held_out.py`).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from adaptsim_jax.attribution.backward import (
    backward_elimination,
    from_afar,
    more,
    scored,
    trimmed,
    where,
)
from adaptsim_jax.attribution.estimate import fit, settled
from adaptsim_jax.attribution.held_out import (
    FittedTree,
    astray,
    attempted,
    evenly_weighted,
    held_error,
    modelled,
    over_floor,
    paired,
    placed,
    refit,
)
from adaptsim_jax.attribution.parameters import Vector
from adaptsim_jax.attribution.problem import TreeProblem, beginnings, own_inertia, scaled_reach
from adaptsim_jax.attribution.score import CandidateScore, JointCandidate, candidates, table
from adaptsim_jax.attribution.stays import eased, steady_each
from adaptsim_jax.attribution.weights import losses
from adaptsim_jax.core.parallel import parallel_map
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.finding import Finding, Step
from adaptsim_jax.diagnosis.rules import step_reason
from adaptsim_jax.effects.base import Reach

ROUNDS = 15  # of the declared model's fit

Hint = tuple[Vector, tuple[JointCandidate, ...]]
"""Values and effects of another witness, to go on from."""


@dataclass(frozen=True, kw_only=True)
class Selection(Finding):
    """What a search by simulated stretches found. stages: models on the way; last: scores at the
    final one; shorter: over the beginnings of stretches only.
    """

    stages: tuple[FittedTree, ...]
    last: tuple[CandidateScore, ...]
    reach: Reach
    shorter: bool = False


def select(
    problem: TreeProblem,
    null: Vector,
    criteria: Criteria,
    notify: Callable[[str], None] = lambda note: None,
    keep: "Callable[[Selection], None]" = lambda found: None,
    hint: Hint | None = None,
) -> Selection:
    """Forward, then each effect beside the others, then against its look-alikes. keep: told of what
    is found, as it goes; hint: values and
    effects to go on from (of another witness), if they predict left-out folds better than the
    declared model.
    """
    base = first = declared(problem, null, criteria, roughly=hint is not None)
    notify("candidates")
    reach = scaled_reach(problem, *own_inertia(problem, base.fit.vector))
    trace: list[Step] = []
    stages = [first]
    scores, forms = (scored(problem, base, reach, laws) for laws in (True, False))
    opening = sorted(scores + forms, key=lambda s: -s.held_out)
    family = max(len(opening), 1)
    if hint is not None and (better := _hinted(problem, base, hint, criteria, trace)):
        base = better
        stages.append(base)
        scores = scored(problem, base, reach, True)

    def partial(model):
        found = (first, model, (), tuple(trace), tuple(opening))
        return Selection(*found, stages=tuple(stages), last=(), reach=reach)

    keep(partial(base))
    while len(base.added) < criteria.most_effects:
        better = _forward(problem, base, scores, family, reach, criteria, trace, notify)
        better = better or _now_and_then(problem, base, reach, criteria, trace, notify)
        if better is None:  # no law holds out any more: what only describes
            if base is not first:
                forms = scored(problem, base, reach, False)
            better = _forward(problem, base, forms, family, reach, criteria, trace, notify)
        if better is None:
            break
        base = better
        stages.append(base)
        keep(partial(base))
        scores = scored(problem, base, reach, True)
    alongside = replace(problem, least=criteria.beside * np.median(held_error(problem, first), 0))
    final, named = backward_elimination(alongside, base, reach, criteria, trace, notify)
    before = first
    if final.fit.vector.index().keys() == first.fit.vector.index().keys():
        # by way of what went a fit may end elsewhere
        if hint is not None:
            before = declared(problem, null, criteria)
        final = before
    found = (before, final, named, tuple(trace), tuple(opening))
    return Selection(*found, stages=tuple(stages), last=tuple(scores), reach=reach)


def _hinted(
    problem: TreeProblem, base: FittedTree, hint: Hint, criteria: Criteria, trace: list[Step]
) -> FittedTree | None:
    """What another witness has found, fitted; None where it does not predict better than the
    base.
    """
    vector, added = hint
    model = modelled(problem, added, fit(problem, vector, rounds=ROUNDS))
    test = paired(problem, base.held.loss, losses(problem, model.held.paths, base.fit.weights))
    if test.gain <= criteria.size or test.p > criteria.confidence:
        return None
    trace += [Step("added", c, test, step_reason("begin_from_other", test.gain)) for c in added]
    return _steady(problem, model, criteria)


def _steady(problem: TreeProblem, model: FittedTree, criteria: Criteria) -> FittedTree:
    """Without the joints at which an effect that was put in at many differs between folds by as
    much as it is.
    """
    gone = [
        e.key
        for c in model.added
        if c.sharing == "all"
        for e, steady in zip(c.entries, steady_each(model, c), strict=True)
        if steady < criteria.steady
    ]
    return trimmed(problem, model, gone, criteria)


def declared(
    problem: TreeProblem, null: Vector, criteria: Criteria, roughly: bool = False
) -> FittedTree:
    """The declared model fitted; where that leaves far more than noise, also by way of the
    stretches' beginnings, over which a fit has fewer minima: of both the one that predicts better.
    roughly: only as far as another is to be compared with it.
    """
    glance = 2 * criteria.glance if roughly else None
    models = [modelled(problem, (), fit(problem, null, rounds=ROUNDS, glance=glance))]
    if not roughly and criteria.beginning < 1.0 and over_floor(problem, models[0]) > criteria.odd:
        begun = fit(beginnings(problem, criteria.beginning), null, rounds=ROUNDS)
        models.append(
            modelled(problem, (), fit(problem, begun.vector, begun.starts, rounds=ROUNDS))
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


def _forward(
    problem, base: FittedTree, scores, family: int, reach, criteria: Criteria, trace, notify
) -> FittedTree | None:
    """The best candidate that gains held out, fitted; None where none does. family: how many
    candidates there are in all.
    """
    hopeful = [
        s
        for s in scores
        if s.p * family < criteria.alpha and s.held_out > 0.5 * criteria.size * base.fit.total
    ]

    def good(model, test):
        return (
            test.gain > criteria.size * max(1, more(model, base))
            and test.better > 0.5 * test.folds
            and test.p <= criteria.confidence
        )

    begun = _begun(problem, base, reach, hopeful[: 2 * criteria.tried])
    # half by what they gain at first order, half by what a step leaves
    first = criteria.tried // 2
    begun = begun[:first] + sorted(begun[first:], key=lambda b: b[3].sum())
    begun = begun[: criteria.tried]
    begun += _begun(problem, base, reach, _larger(problem, scores, [b[0] for b in begun]))
    best = _best(problem, base, begun, good, criteria, trace, notify)
    if best is None:
        reason = step_reason("score_test", passed=len(hopeful), of=len(scores))
        trace.append(Step("ended", None, None, reason))
    return best


def _larger(problem: TreeProblem, scores, tried: list[CandidateScore]) -> list[CandidateScore]:
    """Of what is not tried what has some of it as a special case at the same joints."""
    done = {(s.candidate.effect, s.candidate.joints) for s in tried}

    def holds(c):
        return any((name, c.joints) in done for name in problem.effect(c.effect).contains)

    return [
        s
        for s in scores
        if s.candidate.key not in {t.candidate.key for t in tried} and holds(s.candidate)
    ]


def _begun(problem, base: FittedTree, reach, scores) -> list[tuple]:
    """(score, vector, starts, loss) of the base with each candidate added, one step on."""
    return parallel_map(lambda score: (score, *attempted(problem, base, reach, score)), scores)


def _now_and_then(
    problem, base: FittedTree, reach, criteria: Criteria, trace, notify
) -> FittedTree | None:
    """The same of effects that act now and then only (a limit that few torques reach, a stop that
    few motions come to), where all else is explained and a few stretches are far off. Among all
    stretches these have next to no weight, and a score test sees few.
    """
    outlying = astray(problem, base, criteria)
    if outlying.sum() < criteria.few or over_floor(problem, base) > criteria.explained:
        return None
    plain = modelled(
        problem, base.added, evenly_weighted(problem, base.fit, np.flatnonzero(outlying))
    )
    every = candidates(problem, base.fit.vector, reach)
    scores = {s.candidate.key: s for s in table(problem, plain.lin, every)}

    def left(begun):
        return float(np.median(begun[-1][: len(outlying)][outlying]))

    hopeful = [s for s in scores.values() if s.held_out > criteria.size * plain.fit.total][
        : criteria.tried
    ]
    begun = {b[0].candidate.key: b for b in _begun(problem, plain, reach, hopeful)}
    tries = parallel_map(lambda s: placed(problem, plain, reach, s.candidate), scores.values())
    for key, found in zip(scores, tries, strict=True):
        for c, there in found:
            if key not in begun or left(there) < left(begun[key]):
                begun[key] = (replace(scores[key], candidate=c), *there)

    def good(model, test):
        return (
            test.p < criteria.confidence
            and np.median(
                held_error(problem, model)[outlying] / held_error(problem, plain)[outlying]
            )
            < criteria.left
        )

    return _best(
        problem,
        plain,
        sorted(begun.values(), key=left)[: criteria.tried],
        good,
        criteria,
        trace,
        notify,
    )


def _best(
    problem, base: FittedTree, begun, good, criteria: Criteria, trace, notify
) -> FittedTree | None:
    """Of candidates (score, vector, starts, loss), fitted, the best that is good(model, its test
    against the base).
    """
    weights = base.fit.weights

    def fitted(start) -> FittedTree:
        score, vector, starts, _ = start
        notify(f"{score.candidate.effect} at {where(problem, score.candidate)}")
        joints, glance = score.candidate.joints, 2 * criteria.glance

        def settle(vector, starts):
            return modelled(
                problem,
                (*base.added, score.candidate),
                refit(problem, vector, starts, joints, criteria.rounds, weights, glance),
                weights,
                base,
            )

        return from_afar(problem, settle, vector, starts, criteria.rounds)

    best = None
    for (score, *_), model in zip(begun, parallel_map(fitted, begun), strict=True):
        test = paired(problem, base.held.loss, model.held.loss)
        passed = good(model, test)
        reason = step_reason("forward_fit", model.fit.total / base.fit.total)
        trace.append(Step("tried" if passed else "refused", score.candidate, test, reason))
        if passed and (best is None or _beats(problem, model, best[0], criteria)):
            best = model, score, test
    if best is None:
        return None
    model, score, test = best
    trace.append(Step("added", score.candidate, test, None))
    # its own weights from here on: the residual has become smaller, and with it what matters in it
    again = fit(problem, model.fit.vector, model.fit.starts, rounds=criteria.rounds)
    acting, still = _acting(again.vector, score.candidate)
    again = replace(again, vector=again.vector.without(still))
    return modelled(problem, (*base.added, acting), again)


def _acting(vector: Vector, c: JointCandidate) -> tuple[JointCandidate, list[tuple]]:
    """A candidate at the joints where it does anything, and the keys of its entries at the
    others.
    """
    values = {e.key: z for e, z in zip(vector.entries, vector.values, strict=True)}
    if c.sharing != "all" or all(values[e.key] == e.off for e in c.entries):
        return c, []
    still = [e for e in c.entries if values[e.key] == e.off]
    return c.at([e for e in c.entries if e not in still]), [e.key for e in still]


def _beats(problem: TreeProblem, model: FittedTree, other: FittedTree, criteria: Criteria) -> bool:
    """Whether a model is to be taken instead of another: the one with fewer parameters, unless the
    larger holds out better by `size` for each that it has more.
    """
    small, large = sorted((other, model), key=lambda m: len(m.fit.vector))
    test = paired(problem, small.held.loss, large.held.loss)
    minimum = criteria.size * max(1, more(large, small))
    return (large if test.gain > minimum and test.p < criteria.confidence else small) is model
