"""Sets of effects with one more or some fewer than a fitted model has, refitted whole."""

from collections.abc import Callable

import numpy as np

from adaptsim_jax.core.parallel import parallel_map
from adaptsim_jax.sysid.criteria import Criteria
from adaptsim_jax.sysid.estimate.fit import fit
from adaptsim_jax.sysid.estimate.fitted import Fit, Instance, force_ratio, plausible, rough_gain
from adaptsim_jax.sysid.estimate.problem import Problem
from adaptsim_jax.sysid.score.table import Ranked, ScoreTable
from adaptsim_jax.sysid.select.start import started
from adaptsim_jax.sysid.select.trace import Trace

Progress = Callable[[str], None]


def extend(problem: Problem, current: Fit, ranked: Ranked, seen: ScoreTable, say: Progress = lambda _: None) -> Fit:
    """The current model with one more effect, refitted whole. Less likely than without the effect, it was led astray, and starts
    smaller too."""
    say(f"refitting with {ranked.instance[0]} at {ranked.instance[1]}")
    active = (*current.active, ranked.instance)
    made: list[Fit] = []
    for share in (1.0, 0.1):
        start = current.start(active=active, eff=started(problem, current, ranked, share))
        made.append(fit(problem, start, seen.response, rounds=1))
        if rough_gain(made[-1], current) >= 0.0:
            break
    if ranked.plain:
        start = current.start(active=active, eff=started(problem, current, ranked), x0=None)
        made.append(fit(problem, start, seen.response, weighting="ols", rounds=1))
    return max(made, key=lambda t: t.total)


def newest(best: Fit, current: Fit) -> Instance:
    """The effect that `best` has and `current` lacks."""
    return next(a for a in best.active if a not in current.active)


def without(problem: Problem, trial: Fit, idle: set[Instance], seen: ScoreTable) -> list[Fit]:
    """A set refitted without its idle members, for which the others no longer have to make up; none where none is idle, all are, or
    the rest runs away."""
    rest = tuple(a for a in trial.active if a not in idle)
    if not idle or not rest:
        return []
    less = fit(problem, trial.start(active=rest), seen.response)
    return [less] if less.ok else []


def settle_better_half(problem: Problem, found: Trace, trials: list[Fit], seen: ScoreTable) -> list[Fit]:
    """The better half of the trials refitted until they settle; the others are far enough behind as they are."""
    order = sorted(trials, key=lambda t: -t.merit(problem.criteria.price))
    front = problem.criteria.shortlist // 2
    return settle_some(problem, found, order, order[:front], seen) + order[front:]


def settle_some(problem: Problem, found: Trace, trials: list[Fit], some: list[Fit], seen: ScoreTable) -> list[Fit]:
    """Some of the trials refitted until they settle, save those hopelessly behind one that explains nearly everything."""
    late = hopeless(found, trials, problem.criteria)
    return parallel_map(lambda t: t if late(t) else fit(problem, t, seen.response, rounds=3), some)


def hopeless(found: Trace, trials: list[Fit], criteria: Criteria) -> Callable[[Fit], bool]:
    """Whether a model is hopelessly behind one of the trials that explains nearly everything."""
    fair = [t for t in trials if plausible(t, found.base) and force_ratio(t, found.base) < criteria.clear]
    bar = max((t.total for t in fair), default=-np.inf) - criteria.hopeless
    return lambda model: model.total < bar
