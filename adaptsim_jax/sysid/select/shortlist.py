"""Which candidates are worth a whole refit: the linear scores propose, and where they are blunt, more are tried."""

from collections.abc import Sequence

import numpy as np

from adaptsim_jax.sysid.estimate.fitted import Fit, Instance
from adaptsim_jax.sysid.estimate.problem import Active, Problem
from adaptsim_jax.sysid.score.table import Ranked, ScoreTable, generic_p_value

NEW = 1e-3  # of a candidate's signature that the declared parameters cannot do themselves


def anything(problem: Problem, current: Fit, ranked: Sequence[Ranked], view: ScoreTable) -> bool:
    """Whether there is something to explain: a candidate or some smooth force is no chance, or the force left over is too large for
    one. A stop that is hit in few windows is hardly sure by the scatter of the windows, however much it explains."""
    if np.any(current.parts.force_std() > problem.criteria.large * problem.torque_scale):
        return True
    alpha = problem.criteria.alpha
    return any(r.corrected(len(ranked)) < alpha for r in ranked) or generic_p_value(view) < alpha


def first_leaders(ranked: list[Ranked], view: ScoreTable, active: Active, count: int) -> list[Ranked]:
    """The `count` candidates worth a whole refit: those that explain most by either score.

    The score of one candidate may be blunt (its effect is not small, or moves reversals), and a slow effect hides in the covariance
    that it has inflated, so the plain score has its say too.
    """
    plain = [r for r in view.ranked(active, plain=True) if r.score.retained > NEW][: count // 2]
    names = {r.instance for r in plain}
    fine = [r for r in ranked if r.score.retained > NEW and r.instance not in names]
    return plain + fine[: count - len(plain)]


def further_leaders(
    problem: Problem, leaders: list[Ranked], ranked: list[Ranked], view: ScoreTable, active: Active, count: int
) -> list[Ranked]:
    """Whom to try where the leaders explain nothing: scores of a model that is far off are blunt, so as many again; and
    whatever does not act linearly, by a plain fit, which finds a play of 0.2 rad from far where no score sees it."""
    if not leaders:
        return []
    layout = problem.model.layout
    plainly = {r.instance for r in leaders if r.plain}
    far = [
        r
        for r in view.ranked(active, plain=True)
        if layout.instances[layout.index(*r.instance)].effect.jump and r.instance not in plainly
    ]
    done = {r.instance for r in [*leaders, *far]}
    return far + [r for r in first_leaders(ranked, view, active, 2 * count) if r.instance not in done]


def look_alikes(problem: Problem, best: Instance, ranked: Sequence[Ranked], done: list[Ranked]) -> list[Ranked]:
    """Known look-alikes of the leader that were not refitted, at its joint or, if it is one of its own, at another: the score alone
    must not decide there."""
    layout = problem.model.layout
    names = layout.instances[layout.index(*best)].effect.look_alikes
    tried = {r.instance for r in done}
    beside = lambda name, where: where in (best[1], "base") if name != best[0] else where != best[1]
    near = [r for r in ranked if r.instance[0] in names and beside(*r.instance)]
    return [r for r in near if r.instance not in tried and r.score.retained > NEW]
