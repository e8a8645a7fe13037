"""Integration steps as short as a model needs.

Plain dynamics are exact to a millionth of a radian at a step per row. Where a joint sticks and breaks away, a step is of second
order only, and rows of 5 ms left 20 standard deviations of the sensors in some windows: enough for a second effect that is not
there to pay. What is switched on decides, so steps are halved once an effect has been found, where that moves its simulation.
"""

from dataclasses import replace

import numpy as np

from adaptsim_jax.sysid.estimate.fit import fit
from adaptsim_jax.sysid.estimate.fitted import Fit, Response
from adaptsim_jax.sysid.estimate.problem import DIVERGED, Problem, at_point

SHORTEST = 0.95e-3  # s: shorter steps would cost more than they tell


def stepped(problem: Problem, model: Fit, response: Response) -> tuple[Problem, Fit]:
    """The problem with steps short enough for `model`, and the model refitted with them; both as they were where they were."""
    finer = in_short_steps(problem, model)
    if finer is problem:
        return problem, model
    new = fit(finer, model.start(), response)
    return (finer, new) if new.ok else (problem, model)


def in_short_steps(problem: Problem, model: Fit) -> Problem:
    """The problem with its steps halved until that moves the model's simulation by no more than `criteria.step_share` of the noise."""
    windows = problem.windows
    step = float(np.median(windows.dt[windows.dt > 0])) / int(windows.substeps)
    here = _simulated(problem, model)
    while here is not None and step / 2 >= SHORTEST:
        finer = replace(problem, windows=replace(problem.windows, substeps=2 * problem.windows.substeps))
        there = _simulated(finer, model)
        if there is None or np.sqrt(np.mean(np.square(there - here))) <= problem.criteria.step_share:
            break
        problem, here, step = finer, there, step / 2
    return problem


def _simulated(problem: Problem, model: Fit) -> np.ndarray | None:
    """What the model leaves at its samples, in standard deviations of the sensors; None where it runs away."""
    c = model.candidate
    result = at_point(problem, c.active, c.theta, c.eff, c.refit.point.x0)
    if result.code == DIVERGED:
        return None
    return np.asarray(result.residual)[np.asarray(problem.windows.weight) > 0]
