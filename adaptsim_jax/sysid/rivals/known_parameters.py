"""Whether a known parameter that is wrong would explain the data as well as the effect that was found.

`[known]` parameters are held. Where one of them is off, whatever moves the joints as it does looks like an effect. So the
declared model is fitted once more with all of them free: if that simulates left-out trials as well as the mended model
does, neither can be held responsible.
"""

from collections.abc import Sequence
from typing import NamedTuple

from adaptsim_jax.effects.base import Effect
from adaptsim_jax.sysid.criteria import Criteria
from adaptsim_jax.sysid.decide import Verdict
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
        free, base, first = fit_declared(problem.recording.replace(known={}), problem.audit, problem.noise, effects)
    except Diverged:
        return None
    fitted = {n: p.value for n, p in free.plant.physical(base.candidate.theta).items() if p.value is not None}
    fitted |= dict(zip(free.plant.theta_names, base.candidate.theta, strict=True))
    values = {n: float(fitted[n]) for n in known if n in fitted}
    return Freed(cross_validate(free, base, first), values)


def confounded(
    verdict: Verdict,
    before: CrossValidation,
    after: CrossValidation,
    found: Freed | None,
    known: dict[str, float],
    settings: Criteria,
) -> Verdict:
    """`verdict`, unless freeing what is known explains as much as the effects that it names, or what none explains."""
    if found is None or verdict.name not in ("explained", "explained_class", "structured_unattributed"):
        return verdict
    pairs = [f"{n} is not {known[n]:.4g} but {v:.4g}" for n, v in found.values.items()]
    other = " and ".join(pairs) or "what stands under [known] is wrong"
    if verdict.named:
        if found.error.rmse() > settings.as_well * after.rmse():
            return verdict
        cause = verdict.message.rstrip(".").replace("The residual is explained by ", "").split(";")[0]
        message = f"Either the model lacks {cause}, or {other}: these data cannot tell which."
    else:
        if found.error.rmse() > settings.least_confirmed * before.rmse():
            return verdict
        message = (
            f"The declared model explains the data much better if {other}; an effect that does the same is possible."
        )
    return Verdict("confounded_with_declared", message, False)
