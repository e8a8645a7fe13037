"""A look back at what was accepted before: with another effect in, an earlier one may have been a stand-in for it."""

from adaptsim_jax.core.parallel import parallel_map
from adaptsim_jax.sysid.estimate.fit import fit
from adaptsim_jax.sysid.estimate.fitted import Fit, Instance, gain, likeliest, plausible
from adaptsim_jax.sysid.estimate.problem import Problem
from adaptsim_jax.sysid.score.table import ScoreTable
from adaptsim_jax.sysid.select.earning import choose, needed
from adaptsim_jax.sysid.select.extend import extend, hopeless
from adaptsim_jax.sysid.select.pairs import to_the_bottom, with_swap
from adaptsim_jax.sysid.select.shortlist import look_alikes
from adaptsim_jax.sysid.select.start import merged
from adaptsim_jax.sysid.select.trace import Trace


def swap_back(problem, found: Trace, current: Fit, new: Instance, seen: ScoreTable, say) -> tuple[Trace, Fit]:
    """With another effect in, an earlier one may have been a stand-in: try without it, and its rivals in its place."""
    for old in [a for a in current.active if a != new and a not in found.base.active]:
        rest = tuple(a for a in current.active if a != old)
        say(f"trying without {old[0]} at {old[1]}")
        without = fit(problem, current.start(active=rest), seen.response)
        if not without.ok:  # it cannot be left out
            continue
        found = found.then("tried without one", tried=(without,))
        if plausible(without, found.base) and not needed(problem, current, without, found):
            found, current = found.then("left one out", settled=(old,)), without
            continue
        found, current = _swapped(problem, found, current, old, seen, say)
    return found, current


def _swapped(problem, found: Trace, current: Fit, old: Instance, seen: ScoreTable, say) -> tuple[Trace, Fit]:
    """The best of the likeliest rivals of `old` in its place, if any beats it."""
    price = problem.criteria.price

    def swap(rival: Fit) -> Fit:
        instance = rival.active[-1]
        active = tuple(instance if a == old else a for a in current.active)
        eff = merged(problem, current.candidate.eff, rival.candidate.eff, instance)
        say(f"trying {instance[0]} at {instance[1]} in place of {old[0]}")
        return fit(problem, current.start(active=active, eff=eff), seen.response)

    rivals = sorted(found.rivals.get(old, ()), key=lambda t: -t.merit(price))[:3]
    rivals = [r for r in rivals if r.active[-1] not in current.active]
    # one that runs away is no rival in the presence of the others
    swaps = [(new, r) for new, r in zip(parallel_map(swap, rivals), rivals, strict=True) if new.ok]
    found = found.then("tried rivals in its place", tried=tuple(new for new, _ in swaps))
    fair = [new for new, _ in swaps if plausible(new, found.base) and gain(new, current, price) > 1.0]
    best = likeliest(fair, price)
    if best is None:
        return found, current
    rival = next(r for new, r in swaps if new is best)
    others = tuple(r for r in found.rivals[old] if r is not rival)
    return found.then("swapped", settled=(old,), rivals={rival.active[-1]: others}), best


def beside(problem: Problem, found: Trace, best: Fit, new: Instance, seen: ScoreTable, say) -> tuple[Trace, Fit]:
    """One member of a pair against none and against its look-alikes in its place; the others stay."""
    rest = tuple(a for a in best.active if a != new)
    without = fit(problem, best.start(active=rest), seen.response)
    if not without.ok:  # it cannot be left out
        return found, best
    if rest:  # the other member may have gone already, and the declared model is none of the sets tried
        found = found.then("tried without one", tried=(without,))
    if plausible(without, found.base) and not needed(problem, best, without, found):
        return found, without
    alike = [r for r in look_alikes(problem, new, found.ranked, []) if r.instance not in best.active]
    grown = [t for t in parallel_map(lambda r: extend(problem, without, r, seen, say), alike) if t.ok]
    swaps = parallel_map(lambda r: with_swap(problem, found.base, best, new, r, seen), alike)
    swaps = [t for t in swaps if t.ok]
    late = hopeless(found, [best, *grown, *swaps], problem.criteria)
    trials = [t for t in [*grown, *swaps] if late(t)]
    trials += parallel_map(lambda t: fit(problem, t, seen.response, rounds=3), [t for t in grown if not late(t)])
    trials += parallel_map(lambda t: to_the_bottom(problem, t, seen), [t for t in swaps if not late(t)])
    found = found.then("tried look-alikes in its place", tried=tuple(trials), rivals={new: tuple(trials)})
    return found, choose(problem, [best, *(t for t in trials if plausible(t, found.base))], found.base) or best
