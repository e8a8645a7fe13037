"""Rival models: each refitted whole, under its own residual covariance, and judged by its restricted likelihood."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from adaptsim_jax.effects.base import NINETY
from adaptsim_jax.sysid.estimate import variance
from adaptsim_jax.sysid.estimate.candidate import Candidate, refit_from, refit_more
from adaptsim_jax.sysid.estimate.fit_result import FitResult
from adaptsim_jax.sysid.estimate.problem import Active, Diverged, Problem, at_point, fit_plain
from adaptsim_jax.sysid.estimate.variance import Kernels, Linearised, VarianceComponents

Instance = tuple[str, str]  # (effect, where)


@dataclass(frozen=True)
class Fit:
    """A candidate model with its own residual covariance and its likelihood window by window `[W]`."""

    candidate: Candidate
    parts: VarianceComponents
    likelihood: np.ndarray
    weight: np.ndarray  # [n, taus] how far forces of each kind move the outputs (`Kernels.weight`)
    amiss: tuple[tuple[Instance, str], ...] = ()  # effects whose fitted values are not theirs, and why (`Effect.amiss`)

    @property
    def moving(self) -> np.ndarray:
        """Variance of the unexplained force per joint `[n]` (N m)^2, each part weighed by how far it moves the outputs."""
        return (self.parts.force * self.weight).sum(1)

    @property
    def active(self) -> Active:
        return self.candidate.active

    @property
    def total(self) -> float:
        return float(self.likelihood.sum())

    @property
    def size(self) -> int:
        """How many numbers it took from the data, phases of trials included."""
        return len(self.candidate.names) + self.candidate.phases

    def merit(self, price: float) -> float:
        """Log-likelihood less the price of its parameters."""
        return self.total - price * self.size

    def at_bound(self) -> tuple[str, ...]:
        """Effect parameters that ended at the edge of what they may be. Some shapes have natural ends: Dahl's bristle has no
        damping, a lossless stop no loss, and before a recording there was no torque, or the first one."""
        c = self.candidate
        stuck = zip(c.names, c.refit.point.z, c.refit.at_bound, strict=True)
        return tuple(
            n
            for n, z, at in stuck
            if at and "/" in n and not n.endswith("/before") and not (z == 0.0 and n.endswith(("/damping", "/loss")))
        )


@dataclass(frozen=True)
class Response:
    """How outputs answer to forces, and what unexplained forces do to residuals; rivals share it."""

    lin: Linearised
    kernels: Kernels


def respond(lin: Linearised) -> Response:
    """The response of one linearisation."""
    return Response(lin, variance.force_kernels(lin))


def fitted(
    problem: Problem, active: Active, theta, eff, x0, parts: VarianceComponents, response: Response, *, rounds: int = 4
) -> Fit:
    """Refit a model, estimate its residual covariance, and refit under that until the likelihood settles."""
    return fitted_from(problem, active, at_point(problem, active, theta, eff, x0), parts, response, rounds=rounds)


def fitted_from(
    problem: Problem, active: Active, fit: FitResult, parts: VarianceComponents, response: Response, *, rounds: int = 4
) -> Fit:
    """The same from where a least-squares fit of those effects ended."""
    factor = variance.whitener(response.lin, parts, response.kernels)
    candidate = refit_from(problem, active, fit, factor)
    return settled(problem, _judged(problem, candidate, parts, response), response, rounds=rounds - 1)


def _judged(problem: Problem, candidate: Candidate, parts: VarianceComponents, response: Response) -> Fit:
    lin = candidate.refit.linearised
    try:
        parts = variance.estimate(lin, response.kernels, start=parts)
        likelihood = variance.log_likelihood(lin, parts, response.kernels)
    except np.linalg.LinAlgError:  # forces so far beyond the sensors that their covariance has no factor
        raise Diverged(f"the model with {candidate.active} leaves residuals that no covariance describes") from None
    return Fit(candidate, parts, likelihood, response.kernels.weight, tuple(_amiss(problem, candidate)))


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


def settled(problem: Problem, model: Fit, response: Response, *, rounds: int = 3) -> Fit:
    """The model refitted under its own residual covariance, again and again until its likelihood settles. Where nothing likelier
    is found it stays where it is, with the errors that its own covariance gives: those of the refit before it are of the forces
    that a worse model left, and may hide any effect."""
    for _ in range(rounds):
        factor = variance.whitener(response.lin, model.parts, response.kernels)
        new = _again(problem, model, factor, response)
        gain = -np.inf if new is None else new.total - model.total
        if new is None or gain <= 0.0:
            return _again(problem, model, factor, response, iterations=0) or model
        model = new
        if gain < 1.0:
            break
    return model


def _again(problem: Problem, model: Fit, factor: np.ndarray, response: Response, **more) -> Fit | None:
    """The model refitted from where it is, under another covariance; None where that runs away."""
    with suppress(Diverged):
        return _judged(problem, refit_more(problem, model.candidate, factor, **more), model.parts, response)
    return None


def fitted_plainly(
    problem: Problem,
    active: Active,
    theta,
    eff,
    parts: VarianceComponents,
    response: Response,
    *,
    x0=None,
    rounds: int = 1,
) -> Fit | None:
    """Fitted with the sensors as the only noise, then settled; None where that runs away. This closes large gaps that the
    covariance inflated by the missing effect would leave open. Initial states start from the data, unless given: a model that
    lacks the effect has bent its own."""
    result = fit_plain(problem, active, theta, eff, problem.windows.start if x0 is None else x0)
    return settled_from(problem, active, result, parts, response, rounds=rounds)


def settled_from(
    problem: Problem,
    active: Active,
    result: FitResult,
    parts: VarianceComponents,
    response: Response,
    *,
    rounds: int = 1,
) -> Fit | None:
    """A least-squares fit judged where it ended, then settled; None where it ran away."""
    with suppress(Diverged, np.linalg.LinAlgError):
        return settled(problem, ended(problem, active, result, parts, response), response, rounds=rounds)
    return None


def unmoved(problem: Problem, active: Active, theta, eff, x0, parts: VarianceComponents, response: Response) -> Fit:
    """A model judged where it is, nothing refitted."""
    return ended(problem, active, at_point(problem, active, theta, eff, x0), parts, response)


def ended(problem: Problem, active: Active, fit: FitResult, parts: VarianceComponents, response: Response) -> Fit:
    """A fit judged where it ended, nothing refitted. Raises `Diverged` where it ran away."""
    factor = variance.whitener(response.lin, parts, response.kernels)
    return _judged(problem, refit_from(problem, active, fit, factor, iterations=0), parts, response)


def seen_anew(problem: Problem, model: Fit, response: Response) -> Fit:
    """The model with its likelihood under another response than that of its fit, for what is fitted under that: likelihoods under
    two responses cannot be compared (forces on a joint that sticks do nothing)."""
    factor = variance.whitener(response.lin, model.parts, response.kernels)
    judged = _again(problem, model, factor, response, iterations=0)
    return model if judged is None else replace(model, likelihood=judged.likelihood)


def doubtful(model: Fit, base: Fit) -> set[Instance]:
    """Effects that `base` lacks whose amplitude has the wrong sign or is beyond what the effect may be, or whose values make
    them another effect."""
    bounded = {(effect, where) for effect, where, _ in (n.split("/") for n in model.at_bound())}
    return (bounded | {instance for instance, _ in model.amiss}) - set(base.active)


def plausible(model: Fit, base: Fit) -> bool:
    """No effect is doubtful; what the base model has is not judged."""
    return not doubtful(model, base)


def force_ratio(new: Fit, old: Fit) -> float:
    """Unexplained force after over before, over all joints, weighed by what it does to the motion."""
    return float(np.sqrt(new.moving.sum() / max(old.moving.sum(), 1e-300)))
