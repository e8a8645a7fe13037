"""Whether a known parameter that is wrong would explain the data as well as the effect that was found.

`[known]` parameters are held. Where one of them is off, whatever moves the joints as it does looks like an effect. So the
declared model is fitted once more with all of them free: if that simulates left-out trials as well as the mended model
does, neither can be held responsible.
"""

from collections.abc import Sequence
from typing import NamedTuple

from adaptsim_jax.effects.base import Effect
from adaptsim_jax.sysid.estimate.problem import Diverged, Problem
from adaptsim_jax.sysid.evaluate.crossval import CrossValidation, cross_validate
from adaptsim_jax.sysid.nuisance.null_model import fit_declared


class Freed(NamedTuple):
    """Held-out error of the declared model with nothing known, and what the known parameters came out as."""

    error: CrossValidation
    values: dict[str, float]


def freed(problem: Problem, effects: Sequence[Effect]) -> Freed | None:
    """The declared model with its known parameters free; None where none is known, or it runs away."""
    known = problem.recording.known
    if not known:
        return None
    try:
        free, base, first = fit_declared(
            problem.recording.replace(known={}), problem.audit, problem.noise, effects, criteria=problem.criteria
        )
    except Diverged:
        return None
    fitted = {n: p.value for n, p in free.plant.physical(base.candidate.theta).items() if p.value is not None}
    fitted |= dict(zip(free.plant.theta_names, base.candidate.theta, strict=True))
    values = {n: float(fitted[n]) for n in known if n in fitted}
    return Freed(cross_validate(free, base, first), values)
