"""The one fit: a model with some effects, refitted whole and judged by its restricted likelihood under its own residual covariance.

Declared parameters, effect parameters and initial states are fitted together. Where a fit begins, what weighs its residuals and how
often it is refitted are arguments; how it ended is in its value.
"""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Literal

import numpy as np

from adaptsim_jax.effects.base import NINETY
from adaptsim_jax.sysid.estimate import variance
from adaptsim_jax.sysid.estimate.candidate import Candidate, refit_from, refit_more
from adaptsim_jax.sysid.estimate.fitted import Code, Fit, Instance, Response, Start, rough_gain
from adaptsim_jax.sysid.estimate.gls import nowhere
from adaptsim_jax.sysid.estimate.problem import Diverged, Problem, at_point, by_least_squares
from adaptsim_jax.sysid.estimate.variance import VarianceComponents

SETTLED = 1.0  # of log-likelihood that a round gains: with less, another would gain next to nothing


def fit(
    problem: Problem,
    start: Start | Fit,
    response: Response,
    *,
    weighting: Literal["gls", "ols"] = "gls",
    rounds: int = 4,
) -> Fit:
    """Fit a model from a start, or go on from an earlier fit, and judge it under `response`. Always a fit: `Fit.code` says how it
    ended, and of one that ran away everything is infinitely unlikely.

    weighting: "gls" weighs residuals by the start's covariance `parts`. "ols" takes the sensors for the only noise first, unless
    `start.ended` is such a fit already: that closes large gaps which a covariance inflated by a missing effect would leave open.

    rounds: refits by generalised least squares, each under the covariance that the last left, at most so many and until the
    likelihood settles; 0 judges the model where it is, after least squares where they come first. A fit that goes on stays where
    it was if nothing likelier is found, with the errors that its own covariance gives: those of the refit before it are of the forces
    that a worse model left, and may hide any effect.
    """
    if isinstance(start, Fit):
        if weighting == "gls":
            return _on(problem, start, response, rounds)
        start = start.start()
    try:
        return _from(problem, start, response, weighting, rounds)
    except (Diverged, np.linalg.LinAlgError):
        return _ran_away(problem, start, response)


def _from(problem: Problem, start: Start, response: Response, weighting: str, rounds: int) -> Fit:
    x0 = problem.windows.start if start.x0 is None else start.x0
    point = (problem, start.active, start.theta, start.eff, x0)
    ended = start.ended
    if ended is None:
        ended = by_least_squares(*point) if weighting == "ols" else at_point(*point)
    whole = weighting == "gls" and rounds > 0
    factor = variance.whitener(response.lin, start.parts, response.kernels)
    candidate = refit_from(problem, start.active, ended, factor, iterations=10 if whole else 0)
    code = Code.UNSETTLED if rounds else Code.JUDGED
    model = _judged(problem, candidate, start.parts, response, code)
    return _settled(problem, model, response, rounds - 1 if whole else rounds)


def _on(problem: Problem, model: Fit, response: Response, rounds: int) -> Fit:
    """A fit refitted from where it is; judged there where there are no rounds."""
    if rounds or not model.ok:
        return _settled(problem, model, response, rounds) if model.ok else model
    factor = variance.whitener(response.lin, model.parts, response.kernels)
    judged = _again(problem, model, factor, response, iterations=0)
    return _ran_away(problem, model.start(), response) if judged is None else judged


def _settled(problem: Problem, model: Fit, response: Response, rounds: int) -> Fit:
    for _ in range(rounds):
        factor = variance.whitener(response.lin, model.parts, response.kernels)
        new = _again(problem, model, factor, response)
        gained = -np.inf if new is None else rough_gain(new, model)
        if new is None or gained <= 0.0:
            stays = _again(problem, model, factor, response, iterations=0)
            return model if stays is None else replace(stays, code=Code.SETTLED)
        model = new
        if gained < SETTLED:
            return replace(model, code=Code.SETTLED)
    return model


def _again(problem: Problem, model: Fit, factor: np.ndarray, response: Response, iterations: int = 2) -> Fit | None:
    """The model refitted from where it is, under another covariance; None where that runs away."""
    code = Code.UNSETTLED if iterations else Code.JUDGED
    with suppress(Diverged):
        candidate = refit_more(problem, model.candidate, factor, iterations=iterations)
        return _judged(problem, candidate, model.parts, response, code)
    return None


def _judged(problem: Problem, candidate: Candidate, parts: VarianceComponents, response: Response, code: Code) -> Fit:
    lin = candidate.refit.linearised
    try:
        parts = variance.estimate(lin, response.kernels, start=parts)
        likelihood = variance.log_likelihood(lin, parts, response.kernels)
    except np.linalg.LinAlgError:  # forces so far beyond the sensors that their covariance has no factor
        raise Diverged(f"the model with {candidate.active} leaves residuals that no covariance describes") from None
    amiss = tuple(_amiss(problem, candidate))
    return Fit(candidate, parts, likelihood, response.kernels.weight, amiss, response.number, code)


def _ran_away(problem: Problem, start: Start, response: Response) -> Fit:
    """What is told of a model that has no fit."""
    x0 = problem.windows.start if start.x0 is None else start.x0
    candidate = Candidate(start.active, start.theta, start.eff, (), nowhere(x0))
    parts = replace(start.parts, force=np.full_like(start.parts.force, np.inf))
    amiss = tuple((effect, Code.RAN_AWAY.value) for effect in start.active)
    unlikely, weight = np.full(len(x0), -np.inf), np.ones_like(start.parts.force)
    return Fit(candidate, parts, unlikely, weight, amiss, response.number, Code.RAN_AWAY)


def seen_anew(problem: Problem, model: Fit, response: Response) -> Fit:
    """The model with its likelihood under another response than that of its fit, for what is fitted under that: likelihoods under
    two responses cannot be compared. Where it has none there, that of its fit is taken for it."""
    judged = fit(problem, model, response, rounds=0)
    likelihood = judged.likelihood if judged.ok else model.likelihood
    return replace(model, likelihood=likelihood, response=response.number)


def _amiss(problem: Problem, candidate: Candidate) -> Iterator[tuple[Instance, str]]:
    """Effects of the candidate that their fitted values, on the angles that were measured, show to be something else."""
    layout, windows = problem.model.layout, problem.windows
    for active in candidate.active:
        instance = layout.instances[layout.index(*active)]
        fitted = candidate.parameters(*active)
        if _is_nothing(instance.effect.amplitudes, fitted):
            yield active, "its size cannot be told from none"
        if instance.effect.amiss is None:
            continue
        seen = np.asarray(windows.measured)[..., instance.joint][np.asarray(windows.weight)[..., instance.joint] > 0]
        names = [p.name for p in instance.effect.parameters]
        value = dict(zip(names, candidate.eff[instance.at], strict=True)) | {n: v for n, (v, _) in fitted.items()}
        error = {n: e for n, (_, e) in fitted.items()}
        if why := instance.effect.amiss(value, error, seen, problem.reach.duration):
            yield active, why


def _is_nothing(amplitudes, fitted: dict[str, tuple[float, float]]) -> bool:
    """Whether 90 % intervals of all amplitudes hold the value without effect."""
    known = [(*fitted[p.name], p.off) for p in amplitudes if p.name in fitted]
    return bool(known) and all(abs(value - off) <= NINETY * error for value, error, off in known)
