"""Equivalence classes: the rivals that a recording cannot tell from an effect that was named."""

from collections.abc import Iterator

import numpy as np

from adaptsim_jax.sysid.criteria import Criteria
from adaptsim_jax.sysid.estimate.fitted import Fit, Instance, plausible
from adaptsim_jax.sysid.estimate.problem import Problem
from adaptsim_jax.sysid.select.earning import pays_roughly
from adaptsim_jax.sysid.select.trace import Trace


def class_of(problem: Problem, effect: Instance, found: Trace) -> tuple[Instance, ...]:
    """Rivals that the data cannot tell from the accepted effect."""
    return tuple(dict.fromkeys(instance for instance, _ in _in_place_of(problem, effect, found)))


def close_rivals(problem: Problem, found: Trace) -> list[Fit]:
    """The fits of all rivals that the data cannot tell from an effect of the final model."""
    return [t for effect in found.added for _, t in _in_place_of(problem, effect, found)]


def _in_place_of(problem: Problem, effect: Instance, found: Trace) -> Iterator[tuple[Instance, Fit]]:
    """What was tried in the effect's place, beside the others, and is close. One that holds it as a special case is no rival,
    unless it pays for what it has more: then that was too small to matter, but a spring with its rest far off may have passed for
    a bias."""
    final = found.final
    wider = {i.effect.name for i in problem.model.layout.instances if effect[0] in i.effect.contains}
    rest = [a for a in final.active if a != effect]
    for other in found.tried:
        extra = [a for a in other.active if a not in final.active]
        if (
            len(extra) != 1
            or sorted(a for a in other.active if a != extra[0]) != sorted(rest)
            or not plausible(other, found.base)
            or (extra[0] in {(name, effect[1]) for name in wider} and not pays_roughly(other, final, problem.criteria))
        ):
            continue
        if _close(final, other, problem.criteria):
            yield extra[0], other


def _close(best: Fit, other: Fit, criteria: Criteria) -> bool:
    """Vuong's (1989) comparison over windows: not far behind in nats, or not surely so."""
    gap = best.likelihood - other.likelihood
    price = criteria.price * (best.size - other.size)
    lead = float(gap.sum()) - price
    scatter = float(np.std(gap) * np.sqrt(len(gap))) + 1e-9
    return lead < criteria.class_gap or (lead / scatter < criteria.class_z and lead < 3 * criteria.class_gap)
