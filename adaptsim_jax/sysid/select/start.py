"""Where a refit starts: the grid's shape and the linear score's amplitude."""

import numpy as np

from adaptsim_jax.sysid.estimate.fitted import Fit, Instance
from adaptsim_jax.sysid.estimate.problem import Problem
from adaptsim_jax.sysid.score.table import Ranked


def started(problem: Problem, base: Fit, ranked: Ranked, share: float = 1.0) -> np.ndarray:
    """Effect parameters `[E]` to start a refit from: the grid's shape, `share` of the score's amplitude, kept
    within bounds."""
    layout = problem.model.layout
    low, high = problem.bounds
    eff = base.candidate.eff.copy()
    instance = layout.instances[layout.index(*ranked.instance)]
    amplitudes = iter(ranked.score.amplitude)
    for k, p in enumerate(instance.effect.parameters):
        at = instance.at.start + k
        if p.name in ranked.atom.shape:
            eff[at] = ranked.atom.shape[p.name]
        elif p.off is not None:
            value = next(amplitudes, p.off)
            # Declared parameters that bent to the effect may turn its sign; at zero its shape would have no slope.
            value = abs(value) if p.sign > 0 else value
            eff[at] = p.off + share * (value - p.off)
        eff[at] = np.clip(eff[at], low[at], high[at])
    return eff


def merged(problem: Problem, eff: np.ndarray, other: np.ndarray, instance: Instance) -> np.ndarray:
    """Effect parameters with those of one instance from `other`."""
    layout = problem.model.layout
    at = layout.instances[layout.index(*instance)].at
    out = eff.copy()
    out[at] = other[at]
    return out


def own_starts(problem: Problem, instance: Instance, eff: np.ndarray) -> list[np.ndarray]:
    """Effect parameters `[E]` with those of one instance as its effect would have a fit start (`Effect.starts`), for what is held
    in `eff`."""
    layout = problem.model.layout
    found = layout.instances[layout.index(*instance)]
    effect, names = found.effect, [p.name for p in found.effect.parameters]
    held = [p.name for p in effect.parameters if p.held]
    given = effect.starts(problem.reach, found.joint) if effect.starts else []
    out = []
    for values in given:
        if any(values.get(name) != eff[found.at.start + names.index(name)] for name in held):
            continue
        own = eff.copy()
        for name, value in values.items():
            own[found.at.start + names.index(name)] = value
        out.append(np.clip(own, *problem.bounds))
    return out
