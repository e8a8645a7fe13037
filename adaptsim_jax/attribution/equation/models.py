"""What the balance of forces found, as models of the whole machine: fitted values, how they
predict, what is named.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from adaptsim_jax.attribution.criteria import PRIOR_WIDTH
from adaptsim_jax.attribution.equation.balance import Balance
from adaptsim_jax.attribution.equation.search import GroupSearch, refitted, search_group, within
from adaptsim_jax.attribution.forecast import fitted_starts
from adaptsim_jax.attribution.held_out import FittedTree, HeldOut, squared_error
from adaptsim_jax.attribution.linear import Normal
from adaptsim_jax.attribution.parameters import Vector
from adaptsim_jax.attribution.problem import TreeProblem
from adaptsim_jax.attribution.score import CandidateScore, JointCandidate
from adaptsim_jax.attribution.select import Selection
from adaptsim_jax.attribution.weights import TreeFit, losses, weigh
from adaptsim_jax.core.parallel import parallel_map
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.finding import Named, Step
from adaptsim_jax.effects.base import Reach

START_ROUNDS = 3  # rounds of the starts of stretches


@dataclass(frozen=True)
class TorqueSearch:
    """What the balances of all groups of joints say. null, final: vectors of the whole machine;
    errors [P] of the final one; vetoes: how names went that simulation does not bear out.
    """

    searches: tuple[GroupSearch, ...]
    null: Vector
    final: Vector
    errors: np.ndarray
    vetoes: tuple[Step, ...] = ()

    @property
    def added(self) -> tuple[JointCandidate, ...]:
        return tuple(c for w in self.searches for c in w.added)

    @property
    def named(self) -> tuple[Named, ...]:
        return tuple(n for w in self.searches for n in w.named)


def search_balances(
    problem: TreeProblem,
    balances: Sequence[Balance],
    null: Vector,
    reach: Reach,
    criteria: Criteria,
    commanded: bool,
    factor: float = PRIOR_WIDTH.body_factor,
) -> TorqueSearch:
    """Search the balances of all groups. null: what is fitted whatever is named; commanded, factor:
    as of `search_group`, `within`.
    """

    def own(b):
        return within(part_of(null, b), factor)

    found = tuple(
        parallel_map(
            lambda b: search_group(problem, b, own(b), reach, criteria, commanded), balances
        )
    )
    return merged(null, found)


def merged(null: Vector, searches: Sequence[GroupSearch]) -> TorqueSearch:
    """The vectors of the groups as those of the whole machine."""
    first = null.at(_values(null, [w.null for w in searches]))
    entries = [e for w in searches for e in w.final.entries if e.key not in null.index()]
    final = null.with_entries(entries)
    final = final.at(_values(final, [w.final for w in searches]))
    error = {e.key: s for w in searches for e, s in zip(w.final.entries, w.errors, strict=True)}
    return TorqueSearch(
        tuple(searches), first, final, np.array([error.get(e.key, 0.0) for e in final.entries])
    )


def _values(vector: Vector, parts: Sequence[Vector]) -> np.ndarray:
    known = {e.key: z for v in parts for e, z in zip(v.entries, v.values, strict=True)}
    return np.array(
        [known.get(e.key, z) for e, z in zip(vector.entries, vector.values, strict=True)]
    )


def part_of(null: Vector, balance: Balance) -> Vector:
    """The entries of a vector that act in a group."""
    joints = set(balance.group.joints)
    at = [i for i, e in enumerate(null.entries) if set(e.joints) <= joints]
    return Vector(tuple(null.entries[i] for i in at), null.values[at])


def selection(
    problem: TreeProblem, found: TorqueSearch, null: FittedTree, reach: Reach
) -> Selection:
    """As a search by simulation hands it on: models that predict stretches, effects that are named,
    what was tried. null: the declared model.
    """
    final = model_of(problem, found, found.final, found.added)
    steps = [s for w in found.searches for s in w.steps]
    opening = sorted(
        (_score(s, null.fit.total) for s in _best_tried(steps)), key=lambda s: -s.held_out
    )
    found_by = (null, final, found.named, (*steps, *found.vetoes), tuple(opening))
    return Selection(*found_by, stages=(null,), last=(), reach=reach)


def _best_tried(steps: Sequence[Step]) -> list[Step]:
    """Of each candidate the test in which it did best."""
    best: dict[tuple, Step] = {}
    for s in steps:
        had = best.get(s.candidate.key)
        if s.test is not None and (had is None or had.test is None or s.test.gain > had.test.gain):
            best[s.candidate.key] = s
    return list(best.values())


def _score(step: Step, total: float) -> CandidateScore:
    test = step.test
    assert test is not None  # of `_best_tried`
    share = test.better / max(test.folds, 1)
    return CandidateScore(
        step.candidate, np.zeros(0), test.gain * total, test.gain * total, test.p, share
    )


def model_of(
    problem: TreeProblem,
    found: TorqueSearch,
    vector: Vector,
    added: Sequence[JointCandidate],
    starts: Sequence[np.ndarray] | None = None,
) -> FittedTree:
    """A vector with how it simulates stretches, each from starts fitted to it, with the values of
    the folds that it is not in. starts: from which these are fitted, of a model that is nearly the
    same.
    """
    vectors = _folded(problem, found, vector)
    fold = np.minimum(problem.fold, len(vectors) - 1)
    rows = vectors[fold]
    width = problem.groups[0].stretches.count
    rows = np.concatenate([rows, np.repeat(rows[-1:], width - len(rows), 0)])
    rounds = START_ROUNDS if starts is None else 1
    starts, paths = fitted_starts(problem, vector, rows, rounds, roughly=True, starts=starts)
    weights = weigh(problem, paths)
    loss = losses(problem, paths, weights)
    fit = TreeFit(vector, starts, weights, loss, "converged", 0)
    folds, size = vectors.shape
    nothing = Normal(np.zeros((folds, size, size)), np.zeros((folds, size)))
    held = HeldOut(loss, squared_error(problem, paths), vectors, nothing, tuple(paths))
    return FittedTree(tuple(added), fit, None, held, curvature(found, vector))


def _folded(problem: TreeProblem, found: TorqueSearch, vector: Vector) -> np.ndarray:
    """Values [F, P] without each fold: of the same pieces of the trials as far as balances and
    stretches are cut alike.
    """
    if found.searches:
        count = max(len(w.whole.by_fold) for w in found.searches)
    else:
        count = 1
    out = np.repeat(vector.values[None], max(count, problem.fold.max() + 1), 0)
    index = vector.index()
    for w in found.searches:
        solved = w.base if len(vector) == len(found.null) else w.whole
        for i, e in enumerate(solved.entries):
            if e.key in index:
                off = solved.by_fold[:, i] - solved.step[i]
                out[: len(off), index[e.key]] += off
    return np.clip(out, vector.low, vector.high)


def curvature(found: TorqueSearch, vector: Vector) -> np.ndarray:
    """Of the balance's loss by the values of a vector [P, P], with the prior."""
    out, index = np.diag(np.maximum(vector.precision, 1e-12)), vector.index()
    for w in found.searches:
        solved = w.base if len(vector) == len(found.null) else w.whole
        at = [(i, index[e.key]) for i, e in enumerate(solved.entries) if e.key in index]
        here, there = [i for i, _ in at], [j for _, j in at]
        out[np.ix_(there, there)] = solved.hess[np.ix_(here, here)]
    return out


def without(
    problem: TreeProblem,
    found: TorqueSearch,
    gone: Sequence[JointCandidate],
    instead: Sequence[JointCandidate],
) -> TorqueSearch:
    """Refitted without some effects, with others in their place."""
    out = []
    for w in found.searches:
        joints = set(w.balance.group.joints)
        less = [c for c in w.added if c not in gone] + [
            c for c in instead if set(c.joints) <= joints
        ]
        out.append(w if len(less) == len(w.added) and not instead else refitted(problem, w, less))
    return merged(replace(found.null, values=found.null.values), out)
