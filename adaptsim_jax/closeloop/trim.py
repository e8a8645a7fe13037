"""The last word on effects that came after the first: trials that were not fitted must show them.

Likelihoods and falls of unexplained force are of the data that were fitted. A second effect that only soaks up some of a
wandering torque gains there and nowhere else, so each has to make the model simulate left-out trials better.
"""

from dataclasses import replace

import numpy as np

from adaptsim_jax.closeloop.classes import class_of
from adaptsim_jax.closeloop.earning import Settings
from adaptsim_jax.closeloop.found import Found
from adaptsim_jax.closeloop.heldout import HeldOut, held_out
from adaptsim_jax.closeloop.problem import Diverged, Problem
from adaptsim_jax.closeloop.rivals import Fitted, Instance, fitted
from adaptsim_jax.closeloop.view import View, view

LEAST_GAIN = 0.97  # held-out error with an effect over without it: above this it is not shown by other trials


def trimmed(problem: Problem, found: Found, first: View, settings: Settings) -> tuple[Found, HeldOut | None]:
    """`found` without the effects, if there are several, that left-out trials do not confirm, the least likely first; and
    the held-out simulation of what stays (None where there was nothing to compare)."""
    whole = None
    while len(found.added) > 1:
        whole = held_out(problem, found.final, found.view or first) if whole is None else whole
        without = [(e, w) for e in found.added if (w := _refitted_without(problem, found, e)) is not None]
        for effect, less in sorted(without, key=lambda ew: -ew[1].total):
            seen = view(problem, less)
            other = held_out(problem, less, seen)
            if not confirms(whole, other):
                found, whole = _dropped(problem, found, effect, less, seen, settings), other
                break
        else:
            break
    return found, whole


def confirms(with_effect: HeldOut, without: HeldOut) -> bool:
    """Whether left-out trials are simulated better with an effect: on the whole, and at least half of them."""
    squared = [h.squared.sum(1) for h in (with_effect, without)]
    trials = np.unique(without.trial[without.fold >= 0])
    better = [squared[0][without.trial == t].sum() < squared[1][without.trial == t].sum() for t in trials]
    return bool(with_effect.rmse() < LEAST_GAIN * without.rmse() and 2 * sum(better) >= len(better))


def _refitted_without(problem: Problem, found: Found, effect: Instance) -> Fitted | None:
    """The final model refitted without one of its effects; None where that runs away."""
    c, seen = found.final.candidate, found.view
    if seen is None:
        return None
    rest = tuple(a for a in found.final.active if a != effect)
    try:
        return fitted(problem, rest, c.theta, c.eff, c.refit.point.x0, found.final.parts, seen.response)
    except Diverged:
        return None


def _dropped(problem: Problem, found: Found, effect: Instance, less: Fitted, seen: View, settings: Settings) -> Found:
    rivals = {e: r for e, r in found.rivals.items() if e != effect}
    last, tried = seen.ranked(exclude=less.active), [*found.tried, less]
    out = replace(found, final=less, view=seen, last=last, rivals=rivals, tried=tried, classes={})
    layout = problem.model.layout
    for e in out.added:  # rivals beside both effects, and in the place of the one that stays
        here = class_of(e, out, settings, layout)
        out.classes[e] = here + [r for r in found.classes.get(e, []) if r not in here and r != effect]
    return out
