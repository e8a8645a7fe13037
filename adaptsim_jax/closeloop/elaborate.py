"""The finer shape of an effect once it is found: the knee of a saturation, the second harmonic of a ripple.

In the search such parameters stay at their defaults (`Parameter.late`): an effect is named for what it does by its plain
form, and one that can bend to anything would be named for everything.
"""

from dataclasses import replace

import numpy as np

from adaptsim_jax.closeloop.problem import Diverged, Problem
from adaptsim_jax.closeloop.rivals import Fitted, Instance, fitted, plausible, unexplained
from adaptsim_jax.closeloop.search import Found, Settings, pays
from adaptsim_jax.closeloop.view import View, view
from adaptsim_jax.models.effects import Parameter

INTO = 0.1  # of its range that a parameter starts from its end, where its default is that end and has no slope


def elaborated(problem: Problem, found: Found, first: View, settings: Settings) -> tuple[Problem, Found]:
    """The problem and the final model with late parameters fitted where they pay and explain more; as they were elsewhere."""
    for effect in found.added:
        tried = replace(problem, elaborated=(*problem.elaborated, effect))
        new = _with_late(tried, found.final, effect, (found.view or first))
        if new is None or not pays(new, found.final, settings) or not plausible(new, found.base):
            continue
        if unexplained(new, found.final) < 1.0 - settings.least_fall:
            seen = view(tried, new)
            problem = tried
            found = replace(found, final=new, view=seen, last=seen.ranked(exclude=new.active))
    return problem, found


def _with_late(problem: Problem, model: Fitted, effect: Instance, seen: View) -> Fitted | None:
    """The model refitted with the late parameters of one effect; None where it has none, or that runs away."""
    layout, c = problem.model.layout, model.candidate
    instance = layout.instances[layout.index(*effect)]
    late = [k for k, p in enumerate(instance.effect.parameters) if p.late]
    if not late:
        return None
    eff = np.array(c.eff)
    for k in late:
        eff[instance.at.start + k] = _start(instance.effect.parameters[k])
    try:
        return fitted(problem, c.active, c.theta, eff, c.refit.point.x0, model.parts, seen.response)
    except Diverged:
        return None


def _start(p: Parameter) -> float:
    return p.low + INTO * (p.high - p.low) if p.default == p.low else p.default
