"""The search for what the model lacks: one effect at a time, each rival refitted whole and judged by its likelihood.

A linear score ranks all candidates; the leaders are refitted jointly with the declared parameters, each under its own
residual covariance, and compared by restricted likelihood. What linear scores get wrong (friction at reversals, delays,
stops) the refits put right. Rivals that stay within the scatter of the windows form one class with the leader.
"""

import numpy as np

from adaptsim_jax.core.parallel import parallel_map
from adaptsim_jax.sysid.criteria import Criteria
from adaptsim_jax.sysid.estimate.fit import fit, seen_anew
from adaptsim_jax.sysid.estimate.fitted import Fit, doubtful, force_ratio, gain, likeliest, plausible, rough_gain
from adaptsim_jax.sysid.estimate.problem import Problem
from adaptsim_jax.sysid.nuisance.stepsize import stepped
from adaptsim_jax.sysid.score.table import Ranked, ScoreTable, generic_p_value, view
from adaptsim_jax.sysid.select.earning import choose, completes, earns, pays
from adaptsim_jax.sysid.select.equivalence import class_of, close_rivals
from adaptsim_jax.sysid.select.extend import Progress, extend, newest, settle_better_half, settle_some, without
from adaptsim_jax.sysid.select.nested import elaborated
from adaptsim_jax.sysid.select.pairs import refit_beside_first, to_the_bottom, with_look_alikes
from adaptsim_jax.sysid.select.shortlist import anything, first_leaders, further_leaders, look_alikes
from adaptsim_jax.sysid.select.swap import beside, swap_back
from adaptsim_jax.sysid.select.trace import Trace


def search(problem: Problem, base: Fit, first: ScoreTable, say: Progress = lambda _: None) -> tuple[Problem, Trace]:
    """Add effects greedily while they earn their price, with one look back after each; the problem comes back with the effects
    whose finer shape was fitted.

    An effect that pays for its parameters but explains too little by itself is kept for a while: of two that act together,
    as friction at both joints does, the first leaves most of the residual. The set is judged, not its first member.
    """
    ranked = first.ranked(exclude=base.active)
    found = Trace(base, first, tuple(ranked))
    seen, current, here = first, base, base
    while len(current.active) - len(base.active) < problem.criteria.most_effects:
        found, best, trials = _next(problem, found, here, seen, ranked, say)
        if best is None or not pays(best, here, problem.criteria):
            break
        new = newest(best, current)
        found = found.then("added", rivals={new: tuple(t for t in trials if t is not best)})
        final = here if found.final is current else found.final
        current = best
        accepted = earns(problem, current, final, base) or completes(problem, current, final, base)
        if accepted:
            found, current = swap_back(problem, found, current, new, seen, say)
            problem, found, current = _finer(problem, found, current, seen)
        elif force_ratio(found.final, base) < problem.criteria.explained or _astray(current, base, problem.criteria):
            break
        seen = view(problem, current)
        here = seen_anew(problem, current, seen.response)
        ranked = seen.ranked(exclude=current.active)
        if accepted:
            found = found.then("accepted", final=current, view=seen)
    if force_ratio(found.final, base) > problem.criteria.explained or _still_far(problem, found.final):
        problem, found, current = _paired(problem, found, current, first, say)
    leading = None if current is found.final else current
    classes = {e: class_of(problem, e, found) for e in found.added}
    return problem, found.then("ended", leading=leading, classes=classes)


def _astray(model: Fit, base: Fit, criteria: Criteria) -> bool:
    """Whether what earns no name leaves so much that one more is not worth looking for: one effect all of it, and hardly likelier
    than none (a hum beside a drift left all, yet was likelier by hundreds), or two effects most of it. It changes no name that was
    measured, and without it a real rig takes over half as long again."""
    if len(model.active) - len(base.active) > 1:
        return force_ratio(model, base) > criteria.promising
    return _idle(model, base, criteria)


def _idle(model: Fit, base: Fit, criteria: Criteria) -> bool:
    """Whether a model leaves all of the force and is hardly likelier than none."""
    return force_ratio(model, base) > criteria.idle and rough_gain(model, base) < criteria.slight


def _still_far(problem: Problem, model: Fit) -> bool:
    """Whether a model that explains enough beside a declared one that went astray leaves forces that are too large for chance."""
    return bool(np.any(model.parts.force_std() > problem.criteria.still_far * problem.torque_scale))


def _next(problem: Problem, found: Trace, current: Fit, seen: ScoreTable, ranked: list[Ranked], say):
    """The trace with all that was tried for one more effect than `current` has, the best (None where nothing fits), and all."""
    done = force_ratio(current, found.base) < problem.criteria.explained  # little is left: a shorter list will do
    count = problem.criteria.shortlist // 2 if done else problem.criteria.shortlist
    worth = anything(problem, current, ranked, seen)
    leaders = first_leaders(ranked, seen, current.active, count) if worth else []
    found, trials = _refitted(problem, found, current, leaders, seen, say)
    best = _best(problem, found, trials)
    nothing = best is None or not pays(best, current, problem.criteria)
    if done and nothing and _blatant(problem, current, seen):
        more = further_leaders(problem, leaders, ranked, seen, current.active, count)
        leaders = leaders + more
        found, further = _refitted(problem, found, current, more, seen, say)
        trials = trials + further
        best = _best(problem, found, trials)
    if best is not None and pays(best, current, problem.criteria):
        alike = look_alikes(problem, newest(best, current), ranked, leaders)
        more = [t for t in parallel_map(lambda r: extend(problem, current, r, seen, say), alike) if t.ok]
        more = settle_some(problem, found, trials, more, seen)
        trials, found = trials + more, found.then("tried look-alikes", tried=tuple(more))
        best = _best(problem, found, trials)
    return found, best, trials


def _best(problem: Problem, found: Trace, trials: list[Fit]) -> Fit | None:
    return choose(problem, [t for t in trials if plausible(t, found.base)], found.base)


def _blatant(problem: Problem, model: Fit, seen: ScoreTable) -> bool:
    """Whether what is left moves a joint and follows the motion in all trials."""
    moves = np.any(model.parts.force_std() > problem.criteria.next_to_none * problem.torque_scale)
    return bool(moves) and generic_p_value(seen) < problem.criteria.sure_p


def _paired(problem: Problem, found: Trace, current: Fit, seen: ScoreTable, say):
    """Where the effects found one by one explain too little though something is there: the best pair, if it explains enough, and
    more than they do; else, where none of them may be named, the likeliest set of all for trying."""
    base, price = found.base, problem.criteria.price
    if not anything(problem, base, found.ranked, seen):
        return problem, found, current
    say("refitting with two effects at once")
    trials = refit_beside_first(problem, base, seen)
    for _ in range(2):
        leader = likeliest(trials, price) or base
        left = force_ratio(leader, base)
        if left > problem.criteria.promising or (left < problem.criteria.clear and plausible(leader, base)):
            break
        more = with_look_alikes(problem, base, leader, trials, seen)
        trials = [t for t in trials if t is not leader or plausible(t, base)] + more
    order = sorted(trials, key=lambda t: -t.merit(price))
    front = [t for t in order if plausible(t, base) and not _idle(t, base, problem.criteria)][: problem.criteria.pairs]
    trials = parallel_map(lambda t: to_the_bottom(problem, t, seen), front)
    trials += [alone for t in trials for alone in without(problem, t, doubtful(t, base), seen)]
    found = found.then("tried pairs", tried=tuple(trials))
    anew = lambda model: seen_anew(problem, model, seen.response)
    fair = [t for t in trials if plausible(t, base)]
    best = choose(problem, fair, base)
    if best is None or not earns(problem, best, base, base) or force_ratio(best, base) > problem.criteria.explained:
        return problem, found, current if found.added else max([current, *fair], key=lambda t: anew(t).merit(price))
    if found.added and gain(anew(best), anew(found.final), price) < 0.0:
        return problem, found, current
    found = found.then("began anew with a pair", final=base, view=found.first)
    for new in [a for a in best.active if a not in base.active]:
        found, best = beside(problem, found, best, new, seen, say)
    problem, found, best = _finer(problem, found, best, seen)
    return problem, found.then("accepted a pair", final=best, view=view(problem, best)), best


def _finer(problem: Problem, found: Trace, model: Fit, seen: ScoreTable) -> tuple[Problem, Trace, Fit]:
    """The model in steps as short as it needs, its close rivals with it; and with the late parameters of its effects, where they
    pay and leave less unexplained."""
    finer, fine = stepped(problem, model, seen.response)
    if finer is not problem:
        near = close_rivals(problem, found.then("as it is", final=model))
        again = parallel_map(lambda m: fit(finer, m.start(), seen.response), near)
        again = tuple(m for m in again if m.ok)
        found = found.then("refitted in shorter steps", tried=again, instead_of=tuple(near))
    better = lambda new, old: (
        pays(new, old, problem.criteria) and force_ratio(new, old) < 1.0 - problem.criteria.least_fall
    )
    problem, model = elaborated(finer, fine, found.base, seen.response, better)
    return problem, found, model


def _refitted(
    problem: Problem, found: Trace, current: Fit, leaders: list[Ranked], seen: ScoreTable, say
) -> tuple[Trace, list[Fit]]:
    """The current model with each of the leaders in turn, refitted whole."""
    trials = parallel_map(lambda r: extend(problem, current, r, seen, say), leaders)
    trials = settle_better_half(problem, found, [t for t in trials if t.ok], seen)
    return found.then("tried leaders", tried=tuple(trials)), trials
