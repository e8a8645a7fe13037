"""The last word on effects that came after the first: trials that were not fitted must show them.

Likelihoods and falls of unexplained force are of the data that were fitted. A second effect that only soaks up some of a
wandering torque gains there and nowhere else, so each has to make the model simulate left-out trials better.
"""

import numpy as np

from adaptsim_jax.core.parallel import parallel_map
from adaptsim_jax.sysid.estimate.fit import fit
from adaptsim_jax.sysid.estimate.fitted import Fit, Instance
from adaptsim_jax.sysid.estimate.problem import Problem, initial_states
from adaptsim_jax.sysid.evaluate.crossval import CrossValidation, confirms, cross_validate
from adaptsim_jax.sysid.score.table import ScoreTable, view
from adaptsim_jax.sysid.select.equivalence import class_of
from adaptsim_jax.sysid.select.refine import lowest
from adaptsim_jax.sysid.select.trace import Trace


def backward_eliminated(problem: Problem, found: Trace) -> tuple[Trace, CrossValidation | None]:
    """`found` without the effects, if there are several, that left-out trials do not confirm, the least likely first; and
    the held-out simulation of what stays (None where there was nothing to compare)."""
    whole = None
    while len(found.added) > 1:
        whole = cross_validate(problem, found.final, found.view) if whole is None else whole
        doubted = parallel_map(
            lambda effect, found=found, whole=whole: _nearly(problem, found, whole, effect), found.added
        )
        without = [(e, w) for e, w in zip(found.added, doubted, strict=True) if w is not None]
        for effect, less in sorted(without, key=lambda ew: -ew[1].total):
            seen = view(problem, less)
            other = cross_validate(problem, less, seen)
            if not confirms(whole, other, problem.criteria):
                found, whole = _dropped(problem, found, effect, less, seen), other
                break
        else:
            break
    return found, whole


def _nearly(problem: Problem, found: Trace, whole: CrossValidation, effect: Instance) -> Fit | None:
    """The final model refitted without one of its effects; None where that runs away, or is far off. One that is near is polished
    as the final model was: else what its refit left undone would speak for the effect."""
    seen = found.view
    rest = tuple(a for a in found.final.active if a != effect)
    known = [t for t in found.tried if set(t.active) == set(rest)]
    if known and _far(problem, whole, max(known, key=lambda t: t.total), problem.criteria.very_far):
        return None
    less = fit(problem, found.final.start(active=rest), seen.response)
    if not less.ok or _far(problem, whole, less, problem.criteria.far):
        return None
    return lowest(problem, less, found.base, seen)


def _far(problem: Problem, whole: CrossValidation, less: Fit, times: float) -> bool:
    """Whether a model without an effect simulates the trials that it is fitted to far worse than the one with it does trials that
    it is not fitted to, on the whole and in most trials: left out they would not come closer."""
    c = less.candidate
    found = initial_states(problem, c.active, c.theta, c.eff, c.refit.point.x0)
    weight = np.asarray(problem.windows.weight)
    gap = np.where(weight > 0, found.residual / np.where(weight > 0, weight, 1.0), 0.0)
    own, other, used = (gap**2).sum((1, 2)), whole.squared.sum(1), whole.fold >= 0
    worse = [own[whole.trial == t].sum() > times * other[whole.trial == t].sum() for t in np.unique(whole.trial[used])]
    return bool(own[used].sum() > times * other[used].sum() and 2 * sum(worse) > len(worse))


def _dropped(problem: Problem, found: Trace, effect: Instance, less: Fit, seen: ScoreTable) -> Trace:
    out = found.then("dropped", final=less, view=seen, tried=(less,), settled=(effect,))
    classes = {}
    for e in out.added:  # rivals beside both effects, and in the place of the one that stays
        here = class_of(problem, e, out)
        classes[e] = (*here, *(r for r in found.classes.get(e, ()) if r not in here and r != effect))
    return out.then("classes", classes=classes)
