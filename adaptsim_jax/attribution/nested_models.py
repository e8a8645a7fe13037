"""Nested models of simulated stretches: without an effect, or with another in its place."""

from collections.abc import Callable, Sequence

import numpy as np

from adaptsim_jax.attribution.candidates import CandidateScore, JointCandidate, adjacent, candidates
from adaptsim_jax.attribution.estimate import fit
from adaptsim_jax.attribution.fitted import FittedTree
from adaptsim_jax.attribution.held_out import modelled, paired, refit
from adaptsim_jax.attribution.parameters import Vector
from adaptsim_jax.attribution.problem import TreeProblem
from adaptsim_jax.attribution.score import table
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.effects.base import Reach


def scored(
    problem: TreeProblem,
    model: FittedTree,
    reach: Reach,
    laws: bool,
    near: JointCandidate | None = None,
) -> list[CandidateScore]:
    """Scores of all candidates that are laws, or of those that only describe. near: of those alone
    that act beside it.
    """
    every = candidates(problem, model.fit.vector, reach)
    if near is not None:
        every = [c for c in every if adjacent(c, near)]
    return table(
        problem, model.lin, [c for c in every if problem.effect(c.effect).describes is not laws]
    )


def more(large: FittedTree, small: FittedTree) -> int:
    """Fitted parameters that one model has more than another."""

    def fitted(m):
        return sum(e.low < e.high for e in m.fit.vector.entries)

    return fitted(large) - fitted(small)


def keys_of(model: FittedTree, c: JointCandidate) -> list[tuple]:
    """Keys of an effect's entries in a model, shapes too."""
    return [
        e.key
        for e in model.fit.vector.entries
        if e.owner == c.effect and set(e.joints) <= set(c.joints)
    ]


def without(
    problem: TreeProblem, model: FittedTree, gone: JointCandidate, criteria: Criteria
) -> FittedTree:
    """The model without one of its effects, refitted under the same weights."""
    vector = model.fit.vector.without(keys_of(model, gone))
    less = tuple(c for c in model.added if c is not gone)
    begun = vector, model.fit.starts
    return compared(problem, model, less, model, begun, gone.joints, criteria)


def compared(
    problem: TreeProblem,
    model: FittedTree,
    added: Sequence[JointCandidate],
    like: FittedTree,
    begun: tuple[Vector, Sequence[np.ndarray]],
    joints: Sequence[int],
    criteria: Criteria,
) -> FittedTree:
    """Another model, refitted under the weights of `model` as far as it takes to compare them: to
    the end where it might do as well.

    Args:
        problem: stretches.
        model: what it is compared with.
        added: its effects.
        like: a model that is the same but at `joints`.
        begun: vector and starts from which it is fitted.
        joints: at which it is another.
        criteria: rounds, and from which difference on a fit ends early.
    """
    weights, most = model.fit.weights, criteria.rounds
    fitted = refit(problem, *begun, joints, most, weights, 2 * criteria.glance)
    other = modelled(problem, added, fitted, weights, like)
    left = most - fitted.rounds
    separable = paired(problem, other.held.loss, model.held.loss).gain > criteria.worse_share
    if separable or left <= 0 or fitted.code == "stuck":
        return other
    fitted = refit(problem, fitted.vector, fitted.starts, joints, left, weights)
    return modelled(problem, added, fitted, weights, like)


def from_afar(
    problem: TreeProblem, settle: Callable[..., FittedTree], vector: Vector, starts, rounds: int
) -> FittedTree:
    """settle(vector, starts), which fits under given weights; where that is stuck at once, also
    after a fit by weights of its own: what weighs after a good fit is a narrow valley from afar. Of
    both the one that leaves less.
    """
    found = settle(vector, starts)
    if found.fit.code != "stuck":
        return found
    near = fit(problem, vector, starts, rounds=rounds)
    return min(found, settle(near.vector, near.starts), key=lambda m: m.fit.total)


def trimmed(
    problem: TreeProblem, model: FittedTree, keys: Sequence[tuple], criteria: Criteria
) -> FittedTree:
    """The model without some entries of its effects, refitted; as it is where there are none."""
    if not keys:
        return model
    added = []
    for c in model.added:
        left = [e for e in c.entries if e.key not in keys]
        added += [c if len(left) == len(c.entries) else c.at(left)] if left else []
    own = fit(problem, model.fit.vector.without(keys), model.fit.starts, rounds=criteria.rounds)
    return modelled(problem, added, own)
