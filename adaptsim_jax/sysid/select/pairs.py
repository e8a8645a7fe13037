"""Two effects at once, where no single one explains anything: each hides the other from a search that adds one at a time.

Declared parameters that bent to the one effect leave residuals which the other alone makes no better (a drag and a ripple at one
joint), and where the declared fit went far astray, scores about it say little. So the effects that alone leave least error, by least
squares, are taken first, and the second by the plain scores about that: with the sensors as the only noise, for under a covariance
that both effects have inflated a refit stays where it is.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from adaptsim_jax.core.parallel import parallel_map
from adaptsim_jax.sysid.estimate.fit import fit
from adaptsim_jax.sysid.estimate.fit_result import FitResult
from adaptsim_jax.sysid.estimate.fitted import Fit, Instance, Start, doubtful, gain
from adaptsim_jax.sysid.estimate.problem import DIVERGED, UNFINISHED, Active, Diverged, Problem, by_least_squares
from adaptsim_jax.sysid.score.table import Ranked, ScoreTable, view
from adaptsim_jax.sysid.select.shortlist import NEW, look_alikes
from adaptsim_jax.sysid.select.start import merged, own_starts, started

MOST = 4  # plain refits, one from where the other ended
FIRSTS = 2  # effects that fit best alone
SECONDS = 3  # beside each of them: the right one was among the first two, in tuning and spent sets
NEAR = 0.2  # of a declared parameter: a start that far away is another one

Alone = tuple[Active, FitResult]


class Point(NamedTuple):
    """Where a least-squares fit begins: theta `[P]`, effect parameters `[E]`, initial states `[W, S]`."""

    theta: np.ndarray
    eff: np.ndarray
    x0: np.ndarray


def refit_beside_first(problem: Problem, base: Fit, seen: ScoreTable) -> list[Fit]:
    """Each of the effects that fit best alone, by itself and with the plain score's leaders about the model that has it, refitted
    whole.

    All candidates are fitted alone, for the score about a declared model that went astray puts the right one anywhere: of a play
    and a stop at one joint the stop came twelfth, and left least error."""
    candidates = [r for r in seen.ranked(base.candidate.active, plain=True) if r.score.retained > NEW]
    plain = _without(problem, base)
    alone = [f for f in parallel_map(lambda r: _alone(problem, base, plain, r), candidates) if f[1].code != DIVERGED]
    firsts = parallel_map(
        lambda first: _closer(problem, base, first), sorted(alone, key=lambda one: _error(one[1]))[:FIRSTS]
    )
    return [m for pairs in parallel_map(lambda first: _beside(problem, base, *first, seen), firsts) for m in pairs]


def _error(fit: FitResult) -> tuple[bool, float]:
    """What orders least-squares fits: those that ran away come last."""
    return fit.code == DIVERGED, float(fit.cost.sum())


def _beside(problem: Problem, base: Fit, active: Active, alone: FitResult, seen: ScoreTable) -> list[Fit]:
    """A fit of one effect, and with each of the plain score's leaders about it."""
    try:
        first = fit(problem, Start.after(alone, active, base.parts), seen.response, weighting="ols", rounds=0)
        if not first.ok:
            return []
        about = view(problem, first)
        single = fit(problem, first, seen.response, rounds=1)
    except (Diverged, np.linalg.LinAlgError):  # its response to forces is not finite
        return []
    seconds = [r for r in about.ranked(active, plain=True) if r.score.retained > NEW][:SECONDS]
    made = [
        _likelier(problem, base, (*active, r.instance), alone.theta, started(problem, first, r), seen) for r in seconds
    ]
    return [single, *(m for m in made if m.ok)]


def _likelier(problem: Problem, base: Fit, active: Active, theta, eff: np.ndarray, seen: ScoreTable) -> Fit:
    """A pair fitted from each of the declared parameters to start from, and refitted from where the fit ended that leaves less."""
    fits = [by_least_squares(problem, active, start, eff, problem.windows.start) for start in _starts(problem, theta)]
    start = Start.after(min(fits, key=_error), active, base.parts)
    return fit(problem, start, seen.response, weighting="ols", rounds=1)


def _starts(problem: Problem, theta) -> list[np.ndarray]:
    """Declared parameters to start from: the given ones, and those that the measured motion suggests where they are elsewhere.
    Whatever a missing effect has bent the declared parameters to, no step leads back from where they make windows run away."""
    elsewhere = not np.allclose(theta, problem.theta0, rtol=NEAR, atol=0.1 * NEAR * np.abs(problem.theta0).max())
    return [theta, problem.theta0] if elsewhere else [theta]


def with_look_alikes(problem: Problem, base: Fit, pair: Fit, tried: Sequence[Fit], seen: ScoreTable) -> list[Fit]:
    """Each look-alike of a member in its place, the other as it is, refitted whole: friction that seems to fade may be friction
    and nothing more. Where members are doubtful, only theirs."""
    ranked, done = seen.ranked(pair.active, plain=True), {frozenset(t.active) for t in tried}
    members = sorted(doubtful(pair, base) or set(pair.active) - set(base.active))
    swaps = [(old, r) for old in members for r in look_alikes(problem, old, ranked, [])]
    swaps = [(old, r) for old, r in swaps if frozenset({*pair.active, r.instance} - {old}) not in done]
    made = parallel_map(lambda swap: with_swap(problem, base, pair, *swap, seen), swaps)
    return [m for m in made if m.ok]


def with_swap(problem: Problem, base: Fit, model: Fit, old: Instance, new: Ranked, seen: ScoreTable) -> Fit:
    """`new` in the place of `old`, refitted whole from where the model is."""
    active = tuple(new.instance if a == old else a for a in model.active)
    eff = merged(problem, model.candidate.eff, started(problem, base, new), new.instance)
    start = model.start(active=active, eff=eff, x0=None, parts=base.parts)
    return fit(problem, start, seen.response, weighting="ols", rounds=1)


def _without(problem: Problem, base: Fit) -> Point:
    """The base's own least-squares fit: the way there, half of all steps, is the same for every effect."""
    c = base.candidate
    start = Point(c.theta, c.eff, problem.windows.start)
    ended = by_least_squares(problem, base.active, *start)
    return start if ended.code == DIVERGED else Point(ended.theta, ended.eff, ended.x0)


def _alone(problem: Problem, base: Fit, plain: Point, ranked: Ranked) -> Alone:
    """The least-squares fit with one effect."""
    active = (*base.active, ranked.instance)
    eff = merged(problem, plain.eff, started(problem, base, ranked), ranked.instance)
    return active, by_least_squares(problem, active, plain.theta, eff, plain.x0)


def _closer(problem: Problem, base: Fit, alone: Alone) -> Alone:
    """The fit of one effect, or that from the other declared parameters, or from the effect's own starts beside them, where one
    leaves less; carried on where it ran out of steps."""
    active, first = alone
    starts = [(theta, first.eff) for theta in _starts(problem, base.candidate.theta)[1:]]
    starts += [(problem.theta0, eff) for eff in own_starts(problem, active[-1], first.eff)]
    fits = [first, *(by_least_squares(problem, active, *start, problem.windows.start) for start in starts)]
    best = min(fits, key=_error)
    if best.code == UNFINISHED:
        best = by_least_squares(problem, active, best.theta, best.eff, best.x0)
    return active, best


def to_the_bottom(problem: Problem, model: Fit, seen: ScoreTable) -> Fit:
    """Refitted with the sensors as the only noise until that gains no more, then under its own covariance."""
    for _ in range(MOST):
        new = fit(problem, model.start(x0=None), seen.response, weighting="ols", rounds=1)
        gained = gain(new, model)
        if gained <= 0.0:
            break
        model = new
        if gained <= 1.0:
            break
    return fit(problem, model, seen.response, rounds=3)
