"""The declared model fitted: where its fit starts, which of two fits counts, and the clocks of its trials."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from adaptsim_jax.effects.base import Effect
from adaptsim_jax.logs.noise.floor import NoiseFloor
from adaptsim_jax.logs.quality.findings import Audit
from adaptsim_jax.logs.types import Atom, Recording
from adaptsim_jax.sysid.criteria import Criteria
from adaptsim_jax.sysid.estimate import variance
from adaptsim_jax.sysid.estimate.candidate import surveyed
from adaptsim_jax.sysid.estimate.fit import fit
from adaptsim_jax.sysid.estimate.fit_result import FitResult
from adaptsim_jax.sysid.estimate.fitted import Fit, Response, Start, respond
from adaptsim_jax.sysid.estimate.output_error import FitSettings
from adaptsim_jax.sysid.estimate.problem import (
    DIVERGED,
    Diverged,
    Problem,
    at_point,
    by_least_squares,
    prepare_within_reach,
)
from adaptsim_jax.sysid.estimate.variance import VarianceComponents
from adaptsim_jax.sysid.nuisance.frequency import frequency_of
from adaptsim_jax.sysid.nuisance.phase import clocks
from adaptsim_jax.sysid.nuisance.stepsize import stepped
from adaptsim_jax.sysid.score.table import ScoreTable, view


def fit_declared(
    recording: Recording,
    checked: Audit,
    noise: NoiseFloor,
    effects: Sequence[Effect],
    *,
    duration: float = 0.5,
    criteria: Criteria = Criteria(),  # noqa: B008
) -> tuple[Problem, Fit, ScoreTable]:
    """A recording made ready, in windows of `duration` s or shorter ones, and its declared model fitted: a mended one in steps short
    enough for its effects, and so one that leaves next to no force, as what is left may be the steps' (a link at 50 rad/s, seen to
    50 microradians). Raises Diverged where that runs away from every start."""
    problem, start = prepare_within_reach(recording, checked, noise, effects, duration=duration, criteria=criteria)
    base, first = declared(problem, start)
    if not problem.base and np.any(base.parts.force_std() > criteria.next_to_none * problem.torque_scale):
        return problem, base, first
    problem, fine = stepped(problem, base, first.response)
    return problem, fine, first if fine is base else view(problem, fine)


def declared(problem: Problem, start: FitResult) -> tuple[Fit, ScoreTable]:
    """The declared model with its residual covariance (`declared_base`), and all candidates scored about it."""
    base = declared_base(problem, start)
    return base, view(problem, base)


def declared_base(problem: Problem, start: FitResult) -> Fit:
    """The declared model fitted, with its residual covariance.

    `start` is the regression on the measured motion, which no simulation can lead astray. Where much force is left
    unexplained, least squares from there is a second start: it may find a better optimum, but it may as well flee from the
    effect that is missing to parameters that are far off (a link too heavy to move misses least).
    """
    fits: list[Fit] = []
    result = start
    for second in (False, True):
        if fits and not np.any(fits[0].parts.force_std() > problem.criteria.suspicious * problem.torque_scale):
            break
        with suppress(Diverged, np.linalg.LinAlgError):
            result = _least_squares(problem) if second else _free(problem, start)
            fits += [one for one in [_declared_from(problem, result)] if one.ok]
    if not fits:
        raise Diverged("the declared model runs away from every start; look at the signs and units of the torques")
    base = max(fits, key=lambda m: (_sane(problem, m), m.total))
    if not _sane(problem, base):
        base = _as_it_is(problem, result) or base  # no sane fit: least squares was the last to be tried
    return base


def _sane(problem: Problem, model: Fit) -> bool:
    """Whether the force left unexplained is no larger than the torques themselves."""
    return bool(np.all(model.parts.force_std() < problem.torque_scale))


def _as_it_is(problem: Problem, result: FitResult) -> Fit | None:
    """The least-squares fit without another round. Forces beyond the torques themselves are no chance (a vibration, say),
    and parameters refitted as if they were follow them anywhere."""
    if result.code == DIVERGED:
        return None
    response, parts = _left(problem, result)
    judged = fit(problem, Start.after(result, problem.base, parts), response, rounds=0)
    return judged if judged.ok else None


def _declared_from(problem: Problem, result: FitResult) -> Fit:
    if result.code == DIVERGED:  # before its response to forces is asked for
        raise Diverged("the declared model runs away")
    response, parts = _left(problem, result)
    return fit(problem, Start.after(result, problem.base, parts), response)


def _left(problem: Problem, result: FitResult) -> tuple[Response, VarianceComponents]:
    """How outputs answer to forces about a fit, and the forces that it leaves."""
    _, lin, _ = surveyed(problem, result, candidates=False)
    response = respond(lin)
    return response, variance.estimate(lin, response.kernels)


def _least_squares(problem: Problem) -> FitResult:
    """The declared model fitted with the sensors as the only noise."""
    start = (
        problem.theta0,
        problem.model.layout.off() if problem.eff0 is None else problem.eff0,
        problem.windows.start,
    )
    return by_least_squares(problem, problem.base, *start, FitSettings(iterations=30, huber=1e3))


def _free(problem: Problem, start: FitResult) -> FitResult:
    """A fit of initial states alone, with the declared parameters free to move on from there."""
    return at_point(problem, problem.base, start.theta, start.eff, start.x0)


def timed(problem: Problem, base: Fit, first: ScoreTable) -> tuple[Problem, ScoreTable]:
    """The problem with the trials' clocks set to a periodic force that runs through them, where there is one, and all
    candidates scored again; in long trials after a search between the frequencies of the grid."""
    tone = frequency_of(problem.windows, first.scorer, _clocked(problem, first), problem.criteria.alpha)
    if tone is not None:
        problem = replace(problem, reach=replace(problem.reach, tone=tone))
        first = view(problem, base)
    atoms = _clocked(problem, first)
    found = None if np.any(problem.windows.clock) else clocks(problem.windows, first.scorer, atoms, problem.criteria)
    if found is None:
        return problem, first
    problem = replace(problem, windows=replace(problem.windows, clock=found))
    return problem, view(problem, base)


def _clocked(problem: Problem, seen: ScoreTable) -> list[Atom]:
    names = {e.name for e in problem.model.layout.effects if e.clocked}
    return [a for a in seen.atoms if a.effect in names]
