"""The finer shape of an effect once it is found: the knee of a saturation, the second harmonic of a ripple.

In the search such parameters stay at their defaults (`Parameter.late`): an effect is named for what it does by its plain
form, and one that can bend to anything would be named for everything. Left out altogether they would be found as second
effects that are not there.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from adaptsim_jax.core.parallel import parallel_map
from adaptsim_jax.effects.base import Parameter
from adaptsim_jax.sysid.estimate.fit import fit
from adaptsim_jax.sysid.estimate.fitted import Fit, Instance, Response, gain, plausible
from adaptsim_jax.sysid.estimate.problem import Problem

INTO = 0.1  # of its range that a parameter starts from its end, where its default is that end and has no slope


def elaborated(
    problem: Problem, model: Fit, base: Fit, response: Response, better: Callable[[Fit, Fit], bool]
) -> tuple[Problem, Fit]:
    """The problem and `model` with late parameters of its effects beyond those of `base` fitted, where `better(new, old)`; as
    they were elsewhere."""
    waiting = [effect for effect in model.active if effect not in (*base.active, *problem.elaborated)]
    while waiting:
        problems = [replace(problem, elaborated=(*problem.elaborated, effect)) for effect in waiting]
        late = lambda pe, model=model: _with_late(pe[0], model, pe[1], response)
        made = parallel_map(late, zip(problems, waiting, strict=True))
        pays = [
            (k, new) for k, new in enumerate(made) if new is not None and plausible(new, base) and better(new, model)
        ]
        if not pays:
            break
        first, model = pays[0]
        problem, waiting = problems[first], waiting[first + 1 :]  # these again, beside it
    return problem, model


def _with_late(problem: Problem, model: Fit, effect: Instance, response: Response) -> Fit | None:
    """The model refitted with the late parameters of one effect; None where it has none, or that runs away or gains nothing."""
    layout = problem.model.layout
    instance = layout.instances[layout.index(*effect)]
    late = [k for k, p in enumerate(instance.effect.parameters) if p.late]
    if not late:
        return None
    eff = np.array(model.candidate.eff)
    for k in late:
        eff[instance.at.start + k] = _start(instance.effect.parameters[k])
    new = fit(problem, model.start(eff=eff), response, rounds=1)
    worth = new.ok and gain(new, model) > problem.criteria.round_gain
    return fit(problem, new, response, rounds=3) if worth else None


def _start(p: Parameter) -> float:
    return p.low + INTO * (p.high - p.low) if p.default == p.low else p.default
