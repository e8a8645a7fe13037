"""The search for what the model lacks: one effect at a time, each rival refitted whole and judged by its likelihood.

A linear score ranks all candidates; the leaders are refitted jointly with the declared parameters, each under its own
residual covariance, and compared by restricted likelihood. What linear scores get wrong (friction at reversals, delays,
stops) the refits put right. Rivals that stay within the scatter of the windows form one class with the leader.
"""

from collections.abc import Callable
from contextlib import suppress

import numpy as np

from adaptsim_jax.closeloop.abreast import abreast
from adaptsim_jax.closeloop.classes import class_of
from adaptsim_jax.closeloop.earning import Settings, choose, completes, earns, needed, pays
from adaptsim_jax.closeloop.elaborate import elaborated
from adaptsim_jax.closeloop.found import Found
from adaptsim_jax.closeloop.leaders import anything, first_leaders, further_leaders, look_alikes
from adaptsim_jax.closeloop.pairs import (
    leading_pairs,
    refit_beside_first,
    refit_pair,
    settled_plainly,
    swapped_plainly,
    with_look_alikes,
)
from adaptsim_jax.closeloop.problem import Diverged, Problem
from adaptsim_jax.closeloop.rivals import (
    Fitted,
    Instance,
    doubtful,
    fitted,
    fitted_plainly,
    plausible,
    settled,
    unexplained,
)
from adaptsim_jax.closeloop.start import merged, started
from adaptsim_jax.closeloop.view import Ranked, View, generic_p_value, view

FOLLOWS = 1e-8  # p-value of what a found effect leaves: below this it follows the motion, and the whole list is tried
BLATANT = 0.01  # of the torque: with less force left over the short list will do
Progress = Callable[[str], None]


def search(
    problem: Problem, base: Fitted, first: View, settings: Settings, say: Progress = lambda _: None
) -> tuple[Problem, Found]:
    """Add effects greedily while they earn their price, with one look back after each; the problem comes back with the effects
    whose finer shape was fitted.

    An effect that pays for its parameters but explains too little by itself is kept for a while: of two that act together,
    as friction at both joints does, the first leaves most of the residual. The set is judged, not its first member.
    """
    ranked = first.ranked(exclude=base.active)
    found = Found(base, base, ranked, last=ranked, view=first)
    seen, current, ranked = first, base, found.last
    while len(current.active) - len(base.active) < settings.most_effects:
        best, trials = _next(problem, found, current, seen, ranked, settings, say)
        if best is None or not pays(best, current, settings):
            break
        new = _new(best, current)
        found.rivals[new] = [t for t in trials if t is not best]
        current = best
        enough = earns(problem, current, found.final, base, settings)
        if enough or completes(problem, current, found.final, base, settings):
            current = _look_back(problem, found, current, new, seen, settings, say)
            problem, current = _finer(problem, current, base, seen, settings)
            found.final = current
        elif unexplained(found.final, base) < settings.explained:
            break
        seen = view(problem, current)
        ranked = seen.ranked(exclude=current.active)
        if found.final is current:
            found.view, found.last = seen, ranked
    if unexplained(found.final, base) > settings.explained:
        problem, current = _paired(problem, found, current, first, settings, say)
    found.leading = None if current is found.final else current
    found.rivals = {e: r for e, r in found.rivals.items() if e in found.added}
    found.classes = {e: class_of(e, found, settings, problem.model.layout) for e in found.added}
    return problem, found


def _next(problem: Problem, found: Found, current: Fitted, seen: View, ranked: list[Ranked], settings: Settings, say):
    """The best model with one more effect than `current` (None where nothing fits), and all that were tried for it."""
    done = unexplained(current, found.base) < settings.explained  # little is left: a shorter list will do
    count = settings.shortlist // 2 if done else settings.shortlist
    worth = anything(problem, current, ranked, seen, settings)
    leaders = first_leaders(ranked, seen, current.active, count) if worth else []
    trials = _refitted(problem, found, current, leaders, seen, settings, say)
    trials = trials + _pruned(problem, found, current, trials, seen)
    best = choose(problem, [t for t in trials if plausible(t, found.base)], found.base, settings)
    nothing = best is None or not pays(best, current, settings)
    wanting = done and nothing and _blatant(problem, current, seen)
    poor = best is None or nothing or not earns(problem, best, current, found.base, settings)
    if wanting or (current is found.base and poor):
        more = further_leaders(problem, leaders, ranked, seen, current.active, count)
        leaders = leaders + more
        trials = trials + _refitted(problem, found, current, more, seen, settings, say)
        best = choose(problem, [t for t in trials if plausible(t, found.base)], found.base, settings)
    if best is not None and pays(best, current, settings):
        alike = look_alikes(problem, _new(best, current), ranked, leaders)
        more = abreast(lambda r: extend(problem, current, r, seen, say), alike)
        more = abreast(lambda t: settled(problem, t, seen.response), [t for t in more if t is not None])
        trials, found.tried = trials + more, found.tried + more
        best = choose(problem, [t for t in trials if plausible(t, found.base)], found.base, settings)
    return best, trials


def _blatant(problem: Problem, model: Fitted, seen: View) -> bool:
    """Whether what is left moves a joint and follows the motion in all trials."""
    moves = np.any(model.parts.force_std() > BLATANT * problem.torque_scale)
    return bool(moves) and generic_p_value(seen) < FOLLOWS


def _paired(problem: Problem, found: Found, current: Fitted, seen: View, settings: Settings, say):
    """Where no single effect explained enough for a name though something is there: the best pair, if it does."""
    base = found.base
    if not anything(problem, base, found.ranked, seen, settings):
        return problem, current
    say("refitting with two effects at once")
    trials = refit_beside_first(problem, base, seen)
    for _ in range(2):
        likeliest = max(trials, key=lambda t: t.merit(settings.price), default=base)
        left = unexplained(likeliest, base)
        if left > settings.promising or (left < settings.clear and plausible(likeliest, base)):
            break
        more = with_look_alikes(problem, base, likeliest, trials, seen)
        trials = [t for t in trials if t is not likeliest or plausible(t, base)] + more
    if not any(t is not None and plausible(t, base) and unexplained(t, base) < settings.clear for t in trials):
        trials += abreast(lambda p: refit_pair(problem, base, p, seen), leading_pairs(problem, seen, base.active))
    order = sorted((t for t in trials if t is not None), key=lambda t: -t.merit(settings.price))
    front = [t for t in order if plausible(t, base)][: settings.pairs]
    trials = abreast(lambda t: settled_plainly(problem, t, seen), front)
    trials += [alone for t in trials if (alone := _without(problem, t, doubtful(t, base), seen)) is not None]
    found.tried += trials
    best = choose(problem, [t for t in trials if plausible(t, base)], base, settings)
    if best is None or not earns(problem, best, base, base, settings) or unexplained(best, base) > settings.explained:
        return problem, current
    found.final = base
    for new in [a for a in best.active if a not in base.active]:
        best = _beside(problem, found, best, new, seen, settings, say)
    problem, best = _finer(problem, best, base, seen, settings)
    found.final, found.view = best, view(problem, best)
    found.last = found.view.ranked(exclude=best.active)
    return problem, best


def _finer(problem: Problem, model: Fitted, base: Fitted, seen: View, settings: Settings) -> tuple[Problem, Fitted]:
    """The model with the late parameters of its effects, where they pay and leave less unexplained."""
    better = lambda new, old: pays(new, old, settings) and unexplained(new, old) < 1.0 - settings.least_fall
    return elaborated(problem, model, base, seen.response, better)


def _beside(problem: Problem, found: Found, best: Fitted, new: Instance, seen: View, settings: Settings, say) -> Fitted:
    """One member of a pair against none and against its look-alikes in its place; the others stay."""
    c, rest = best.candidate, tuple(a for a in best.active if a != new)
    try:
        without = fitted(problem, rest, c.theta, c.eff, c.refit.point.x0, best.parts, seen.response)
    except Diverged:  # it cannot be left out
        return best
    if rest:  # the other member may have gone already, and the declared model is none of the sets tried
        found.tried.append(without)
    if plausible(without, found.base) and not needed(problem, best, without, found, settings):
        return without
    alike = [r for r in look_alikes(problem, new, found.ranked, []) if r.instance not in best.active]
    grown = abreast(lambda r: extend(problem, without, r, seen, say), alike)
    swaps = abreast(lambda r: swapped_plainly(problem, found.base, best, new, r, seen), alike)
    trials = abreast(lambda t: settled(problem, t, seen.response), [t for t in grown if t is not None])
    trials += abreast(lambda t: settled_plainly(problem, t, seen), [t for t in swaps if t is not None])
    found.tried, found.rivals[new] = found.tried + trials, trials
    return choose(problem, [best, *(t for t in trials if plausible(t, found.base))], found.base, settings) or best


def _pruned(problem: Problem, found: Found, current: Fitted, trials: list[Fitted], seen: View) -> list[Fitted]:
    """Trials in which the new effect makes an earlier one idle or absurd, which had stood in for it: the same without that one,
    where they are likelier than any trial that may be."""
    bar = max((t.total for t in trials if plausible(t, found.base)), default=current.total)
    out = []
    for trial in trials:
        new = _new(trial, current)
        idle = doubtful(trial, found.base) - {new}
        if new in doubtful(trial, found.base) or not idle or trial.total <= bar:
            continue
        out.append(_without(problem, trial, idle, seen))
    out = [t for t in out if t is not None]
    found.tried += out
    return out


def _without(problem: Problem, trial: Fitted, idle: set[Instance], seen: View) -> Fitted | None:
    """A set refitted without its idle members, for which the others no longer have to make up; None where none is idle, all are, or
    the rest runs away."""
    c, rest = trial.candidate, tuple(a for a in trial.active if a not in idle)
    if not idle or not rest:
        return None
    with suppress(Diverged):
        return fitted(problem, rest, c.theta, c.eff, c.refit.point.x0, trial.parts, seen.response)
    return None


def _refitted(
    problem: Problem, found: Found, current: Fitted, leaders: list[Ranked], seen: View, settings: Settings, say
):
    """The current model with each of the leaders in turn, refitted whole."""
    trials = abreast(lambda r: extend(problem, current, r, seen, say), leaders)
    trials = _finished(problem, [t for t in trials if t is not None], seen, settings)
    found.tried += trials
    return trials


def _finished(problem: Problem, trials: list[Fitted], seen: View, settings: Settings) -> list[Fitted]:
    """The better half of the trials refitted until they settle; the others are far enough behind as they are."""
    order = sorted(trials, key=lambda t: -t.merit(settings.price))
    front = settings.shortlist // 2
    return abreast(lambda t: settled(problem, t, seen.response), order[:front]) + order[front:]


def extend(
    problem: Problem, current: Fitted, ranked: Ranked, seen: View, say: Progress = lambda _: None
) -> Fitted | None:
    """The current model with one more effect, refitted whole; None where that runs away however small it starts. Less likely than
    without the effect, it was led astray, and starts smaller too."""
    say(f"refitting with {ranked.instance[0]} at {ranked.instance[1]}")
    c = current.candidate
    active = (*c.active, ranked.instance)
    made = []
    for share in (1.0, 0.1):
        eff = started(problem, current, ranked, share)
        try:
            made.append(fitted(problem, active, c.theta, eff, c.refit.point.x0, current.parts, seen.response, rounds=1))
        except Diverged:
            continue
        if made[-1].total >= current.total:
            break
    if ranked.plain:
        eff = started(problem, current, ranked)
        made.append(fitted_plainly(problem, active, c.theta, eff, current.parts, seen.response))
    return max((m for m in made if m is not None), key=lambda t: t.total, default=None)


def _new(best: Fitted, current: Fitted) -> Instance:
    return next(a for a in best.active if a not in current.active)


def _look_back(problem, found: Found, current: Fitted, new: Instance, seen: View, settings: Settings, say) -> Fitted:
    """With another effect in, an earlier one may have been a stand-in: try without it, and its rivals in its place."""
    for old in [a for a in current.active if a != new and a not in found.base.active]:
        c = current.candidate
        rest = tuple(a for a in current.active if a != old)
        say(f"trying without {old[0]} at {old[1]}")
        try:
            without = fitted(problem, rest, c.theta, c.eff, c.refit.point.x0, current.parts, seen.response)
        except Diverged:  # it cannot be left out
            continue
        found.tried.append(without)
        if plausible(without, found.base) and not needed(problem, current, without, found, settings):
            found.rivals.pop(old, None)
            current = without
            continue
        current = _swapped(problem, found, current, old, seen, settings, say)
    return current


def _swapped(problem, found: Found, current: Fitted, old: Instance, seen: View, settings: Settings, say) -> Fitted:
    """The best of the likeliest rivals of `old` in its place, if any beats it."""
    c = current.candidate

    def swap(rival: Fitted) -> Fitted | None:
        instance = rival.active[-1]
        active = tuple(instance if a == old else a for a in current.active)
        eff = merged(problem, c.eff, rival.candidate.eff, instance)
        say(f"trying {instance[0]} at {instance[1]} in place of {old[0]}")
        with suppress(Diverged):  # else no rival in the presence of the others
            return fitted(problem, active, c.theta, eff, c.refit.point.x0, current.parts, seen.response)
        return None

    merit = lambda model: model.merit(settings.price)
    rivals = sorted(found.rivals.get(old, []), key=lambda t: -merit(t))[:3]
    rivals = [r for r in rivals if r.active[-1] not in current.active]
    swaps = [(new, r) for new, r in zip(abreast(swap, rivals), rivals, strict=True) if new is not None]
    found.tried += [new for new, _ in swaps]
    fair = [(new, r) for new, r in swaps if plausible(new, found.base) and merit(new) > merit(current) + 1.0]
    if not fair:
        return current
    best, rival = max(fair, key=lambda new_rival: merit(new_rival[0]))
    found.rivals[rival.active[-1]] = [r for r in found.rivals.pop(old) if r is not rival]
    return best
