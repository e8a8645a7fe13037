"""Phases of trials found again with the periodic force in the model.

The first clocks (`nuisance/phase.py`) come from linear scores about a model that lacks the force. Once it is in, each trial's clock
is one more parameter whose derivative is at hand, and Gauss-Newton steps make it as sharp as the rest: once before the search,
so that rivals are compared with phases that are right, and once for the final model.
"""

from dataclasses import replace

import numpy as np

from adaptsim_jax.core.parallel import parallel_map
from adaptsim_jax.sysid.estimate import variance
from adaptsim_jax.sysid.estimate.candidate import compressed, linearised
from adaptsim_jax.sysid.estimate.fit import fit
from adaptsim_jax.sysid.estimate.fitted import Fit, Response, rough_gain
from adaptsim_jax.sysid.estimate.problem import Problem, at_point
from adaptsim_jax.sysid.score.table import ScoreTable, view
from adaptsim_jax.sysid.select.extend import extend
from adaptsim_jax.sysid.select.trace import Trace

TRIED = 2  # periodic forces that clocks are sharpened with
STEP = 1e-5  # s: the angle of a force of 60 Hz moves by 4e-3 rad


def phases_refined(problem: Problem, found: Trace, rounds: int = 3) -> tuple[Problem, Trace]:
    """The problem with better clocks and the final model refitted with them; both as they were where that is no likelier,
    or where no effect of the final model has a clock."""
    if not problem.phases(found.final.active):
        return problem, found
    problem, model = _sharper(problem, found.final, found.view.response, rounds)
    if model is found.final:
        return problem, found
    return problem, found.then("phases refined", final=model, view=view(problem, model))


def _sharper(problem: Problem, model: Fit, response: Response, rounds: int = 3) -> tuple[Problem, Fit]:
    """`phases_refined` of a model alone; one without a clock keeps the problem's."""
    if not problem.phases(model.active):
        return problem, model
    clock = problem.windows.clock
    for _ in range(rounds):
        tried = replace(problem, windows=replace(problem.windows, clock=clock + clock_step(problem, model, response)))
        new = fit(tried, model.start(), response)
        if rough_gain(new, model) <= 0.0:
            break
        settled = rough_gain(new, model) < 1.0
        problem, model, clock = tried, new, tried.windows.clock
        if settled:
            break
    return problem, model


def phases_refined_early(problem: Problem, first: ScoreTable, base: Fit) -> tuple[Problem, ScoreTable]:
    """The problem with clocks found again beside the likeliest periodic force, before rivals are compared by them, and the scores
    about `base` with them. A base model that bends to a hum (its inertia does) is a poor place to tell phases from."""
    if not np.any(problem.windows.clock) or problem.phases(base.active):
        return problem, first
    layout = problem.model.layout
    clocked = [r for r in first.ranked(base.active) if layout.instances[layout.index(*r.instance)].effect.clocked]
    models = parallel_map(lambda r: extend(problem, base, r, first), clocked[:TRIED])
    best = max((m for m in models if m.ok), key=lambda m: m.total, default=base)
    better, sharp = _sharper(problem, best, first.response)
    if better is problem:
        return problem, first
    tone, _ = sharp.candidate.parameters(*sharp.active[-1])["frequency"]
    better = replace(better, reach=replace(better.reach, tone=float(tone)))
    return better, view(better, base)


def clock_step(problem: Problem, model: Fit, response) -> np.ndarray:
    """Gauss-Newton step `[N]` s of the trials' clocks, initial states projected out, everything else held."""
    c = model.candidate
    point = (c.active, c.theta, c.eff, c.refit.point.x0)
    later = replace(problem, windows=replace(problem.windows, clock=problem.windows.clock + STEP))
    here, there = (compressed(p, linearised(p, at_point(p, *point))) for p in (problem, later))
    slope = (here.residual - there.residual)[..., None] / STEP  # of the outputs, in standard deviations a second
    factor = variance.whitener(response.lin, model.parts, response.kernels)
    white = variance.whiten(replace(here, atoms=slope), factor)
    step = np.zeros_like(problem.windows.clock)
    for trial in np.unique(white.trial[white.rows > 0]):
        at = (white.trial == trial) & (white.rows > 0)
        j, r = white.atoms[at, :, 0], white.residual[at]
        step[trial] = np.sum(j * r) / max(np.sum(j * j), 1e-300)
    return step
