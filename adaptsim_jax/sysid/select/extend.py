"""Sets of effects with one more or some fewer than a fitted model has, refitted whole."""

from collections.abc import Callable
from contextlib import suppress

import numpy as np

from adaptsim_jax.core.parallel import parallel_map
from adaptsim_jax.sysid.criteria import Criteria
from adaptsim_jax.sysid.estimate.fit import Fit, Instance, fitted, fitted_plainly, force_ratio, plausible, settled
from adaptsim_jax.sysid.estimate.problem import Diverged, Problem
from adaptsim_jax.sysid.score.table import Ranked, ScoreTable
from adaptsim_jax.sysid.select.start import started
from adaptsim_jax.sysid.select.trace import Trace

Progress = Callable[[str], None]


def extend(
    problem: Problem, current: Fit, ranked: Ranked, seen: ScoreTable, say: Progress = lambda _: None
) -> Fit | None:
    """The current model with one more effect, refitted whole; None where that runs away however small it starts. Less likely than
    without the effect, it was led astray, and starts smaller too."""
    say(f"refitting with {ranked.instance[0]} at {ranked.instance[1]}")
    c = current.candidate
    active = (*c.active, ranked.instance)
    made = []
    for share in (1.0, 0.1):
        eff = started(problem, current, ranked, share)
        try:
            made.append(fitted(problem, active, c.theta, eff, c.refit.point.x0, current.parts, seen.response, rounds=1))
        except Diverged:
            continue
        if made[-1].total >= current.total:
            break
    if ranked.plain:
        eff = started(problem, current, ranked)
        made.append(fitted_plainly(problem, active, c.theta, eff, current.parts, seen.response))
    return max((m for m in made if m is not None), key=lambda t: t.total, default=None)


def newest(best: Fit, current: Fit) -> Instance:
    """The effect that `best` has and `current` lacks."""
    return next(a for a in best.active if a not in current.active)


def without(problem: Problem, trial: Fit, idle: set[Instance], seen: ScoreTable) -> Fit | None:
    """A set refitted without its idle members, for which the others no longer have to make up; None where none is idle, all are, or
    the rest runs away."""
    c, rest = trial.candidate, tuple(a for a in trial.active if a not in idle)
    if not idle or not rest:
        return None
    with suppress(Diverged):
        return fitted(problem, rest, c.theta, c.eff, c.refit.point.x0, trial.parts, seen.response)
    return None


def finished(problem: Problem, found: Trace, trials: list[Fit], seen: ScoreTable) -> list[Fit]:
    """The better half of the trials refitted until they settle; the others are far enough behind as they are."""
    order = sorted(trials, key=lambda t: -t.merit(problem.criteria.price))
    front = problem.criteria.shortlist // 2
    return settled_few(problem, found, order, order[:front], seen) + order[front:]


def settled_few(problem: Problem, found: Trace, trials: list[Fit], some: list[Fit], seen: ScoreTable) -> list[Fit]:
    """Some of the trials refitted until they settle, save those hopelessly behind one that explains nearly everything."""
    late = hopeless(found, trials, problem.criteria)
    return parallel_map(lambda t: t if late(t) else settled(problem, t, seen.response), some)


def hopeless(found: Trace, trials: list[Fit], criteria: Criteria) -> Callable[[Fit], bool]:
    """Whether a model is hopelessly behind one of the trials that explains nearly everything."""
    fair = [t for t in trials if plausible(t, found.base) and force_ratio(t, found.base) < criteria.clear]
    bar = max((t.total for t in fair), default=-np.inf) - criteria.hopeless
    return lambda model: model.total < bar
