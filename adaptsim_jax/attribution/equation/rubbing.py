"""Whether dry friction along a measured motion is sharp, as of real joints, or gives, as a
simulator's.

MuJoCo's dry friction is a soft constraint: below its level it leaves a joint some of its
acceleration and ends its speed at a rate. So it turns a time constant (10 ms, unless a file says
otherwise) ahead of the speed, over a band of its own; in the balance of a stiff servo that looks
like rotors, gains and dead zones. Both laws are held against the motion once, and the sharp one
stays unless the other tells it better.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from adaptsim_jax.attribution.equation.balance import Balance, ahead_of
from adaptsim_jax.attribution.equation.balance_objective import likely_first
from adaptsim_jax.attribution.equation.models import separable_candidates
from adaptsim_jax.attribution.equation.searched import Searched
from adaptsim_jax.attribution.parameters import Vector
from adaptsim_jax.attribution.problem import TreeProblem
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.testing import compare, log_ratio, preferred
from adaptsim_jax.effects.base import Reach
from adaptsim_jax.mechanisms.tree import Tree

GIVES = (
    "Dry friction gives as MuJoCo's does (solreffriction, solimpfriction), as in a simulator's "
    "log: it is simulated so, and no effect is named for it."
)


def rubbing(
    problem: TreeProblem,
    tree: Tree,
    balances: Sequence[Balance],
    part,
    reach: Reach,
    criteria: Criteria,
    commanded: bool,
) -> tuple[TreeProblem, tuple[Balance, ...]]:
    """Problem and balances with dry friction as the motion shows it. tree: of the whole machine,
    with the softness of its file; part: of a balance, the entries that are always fitted. One law
    holds for all joints, and one joint may show it.
    """
    softness = np.asarray(tree.friction_softness, float)
    if not np.any(softness):
        return problem, tuple(balances)
    soft = giving(problem, tree)
    other = tuple(given(b, soft) for b in balances)

    def searched(p: TreeProblem, b: Balance, null: Vector) -> Searched:
        return Searched(p, b, null, reach, criteria, commanded)

    joints = []
    for sharp, gives in zip(balances, other, strict=True):
        null = part(sharp)
        joints += list(gains(searched(problem, sharp, null), searched(soft, gives, null)).T)
    limits = criteria.torque
    tests = [compare(z, z) for z in joints]
    shows = [preferred(t, limits.gain, limits.level, len(joints)) for t in tests]
    if any(shows) and np.mean([z.mean() for z in joints]) > 0.0:
        return (soft, other)
    return (problem, tuple(balances))


def giving(problem: TreeProblem, tree: Tree) -> TreeProblem:
    """The same with dry friction that gives as the file has it."""
    softness = np.asarray(tree.friction_softness, float)

    def of(g):
        return replace(
            g,
            model=replace(
                g.model, tree=replace(g.model.tree, friction_softness=softness[list(g.joints)])
            ),
        )

    return replace(problem, groups=tuple(of(g) for g in problem.groups))


def friction_notes(problem: TreeProblem) -> list[str]:
    """That dry friction gives, where it does."""
    gives = any(np.any(g.model.tree.friction_softness) for g in problem.groups)
    if gives:
        return [GIVES]
    return []


def given(balance: Balance, soft: TreeProblem) -> Balance:
    """A balance of the same motion with friction that gives. soft: of `giving`."""
    group = next(g for g in soft.groups if g.joints == balance.group.joints)
    return replace(balance, group=group, ahead=ahead_of(group.model.tree, balance.ahead, balance.a))


def gains(sharp: Searched, gives: Searched) -> np.ndarray:
    """Logarithms [B, n] of what sharp friction leaves of left-out blocks over what the giving one
    does. Each with what all joints are likely to have (a delay of commands, friction at each
    joint).
    """
    left = [
        s.set_of(likely_first(s, separable_candidates(s))[0]).left_out(s.rows)
        for s in (sharp, gives)
    ]
    return log_ratio(*(sharp.rows.loss(z) for z in left))
