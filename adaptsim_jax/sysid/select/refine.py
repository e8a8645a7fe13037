"""The final model fitted once more from where it stands, with the sensors as the only noise.

A refit under a covariance that the missing effect had inflated stops short of the bottom where effects switch (a play that is
taken up, a joint that sticks): what is left to gain looks like chance there. The plain fit goes on: from the initial states
that were found, as of those in the data some lie on the wrong side of a switch; and from those in the data, as a model that
was far off has bent its own.
"""

from functools import partial

import numpy as np

from adaptsim_jax.core.parallel import parallel_map
from adaptsim_jax.sysid.estimate.fit import fit
from adaptsim_jax.sysid.estimate.fitted import Fit, plausible, rough_gain
from adaptsim_jax.sysid.estimate.problem import Problem
from adaptsim_jax.sysid.score.table import ScoreTable, view
from adaptsim_jax.sysid.select.trace import Trace

ROUNDS = 4  # each from where the last ended
NUDGES = (0.96, 1.04)  # of what switches: a fit may rest where no event of the data changes sides


def refined(problem: Problem, found: Trace) -> Trace:
    """`found` with its final model at the bottom; unchanged where it was there, or nothing is left to gain."""
    if not found.added or np.all(found.final.parts.force_std() < problem.criteria.nothing_left * problem.torque_scale):
        return found
    model = lowest(problem, found.final, found.base, found.view)
    if model is found.final:
        return found
    return found.then("refined", final=model, view=view(problem, model))


def lowest(problem: Problem, model: Fit, base: Fit, seen: ScoreTable) -> Fit:
    """The likeliest model that plain fits reach, round after round, from its own place and from nudged ones, or a refit under its
    own covariance."""
    for _ in range(ROUNDS):
        model = fit(problem, model, seen.response, rounds=3)
        c = model.candidate
        starts = [(c.eff, None), *((eff, c.refit.point.x0) for eff in (c.eff, *_nudged(problem, model)))]
        tried = parallel_map(partial(_again, problem, model, seen), starts)
        best = max((t for t in tried if t.ok and plausible(t, base)), key=lambda t: t.total, default=model)
        if rough_gain(best, model) < problem.criteria.round_gain:
            break
        model = best
    return model


def _again(problem: Problem, model: Fit, seen: ScoreTable, start: tuple[np.ndarray, np.ndarray | None]) -> Fit:
    """A plain fit from the model's declared parameters; start: effect parameters, and initial states (None: the data's)."""
    eff, x0 = start
    return fit(problem, model.start(eff=eff, x0=x0), seen.response, weighting="ols", rounds=3)


def _nudged(problem: Problem, model: Fit) -> list[np.ndarray]:
    """Effect parameters with each size of an effect that switches a little smaller and larger."""
    layout, out = problem.model.layout, []
    for active in model.active:
        instance = layout.instances[layout.index(*active)]
        if not instance.effect.jump or active in problem.base:
            continue
        for share in NUDGES:
            eff = model.candidate.eff.copy()
            eff[instance.at.start] *= share
            out.append(eff)
    return out
