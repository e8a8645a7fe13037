"""Models as they predict trials left out: parameters of a fold from the others, its prediction, and
the test of two models by it.

Parameters of a fold come from the normal equations without it, one step from the whole fit (exact
for a linear model; the infinitesimal jackknife otherwise), and the prediction is simulated, with
starts fitted to the fold's own stretches by least squares.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from adaptsim_jax.attribution.candidates import CandidateScore, JointCandidate, shape_entries
from adaptsim_jax.attribution.criteria import CONFIRMATION, STRETCH
from adaptsim_jax.attribution.estimate import (
    Linear,
    candidate_columns,
    fit,
    inside,
    linear,
    normal,
    padded_fold,
    settled,
    start_steps,
    unchanged,
)
from adaptsim_jax.attribution.fitted import FittedTree, HeldOut
from adaptsim_jax.attribution.parameters import Entry, Normal, TreeFit, Vector, Weights
from adaptsim_jax.attribution.paths import group_losses, losses, residuals, run
from adaptsim_jax.attribution.problem import TreeProblem
from adaptsim_jax.attribution.simulate import Path
from adaptsim_jax.diagnosis.criteria import FOLD
from adaptsim_jax.diagnosis.folds import pieces
from adaptsim_jax.diagnosis.testing import Test, paired_test
from adaptsim_jax.effects.base import Effect, Reach


def touched(problem: TreeProblem, entries: Iterable[Entry], joints: Sequence[int]) -> list[int]:
    """Numbers of the groups that a change at `joints` touches: all of them where groups share a
    value.
    """
    owner = {j: k for k, g in enumerate(problem.groups) for j in g.joints}
    if any(len({owner[j] for j in e.joints}) > 1 for e in entries):
        return list(range(len(problem.groups)))
    return sorted({owner[j] for j in joints})


def by_group(problem: TreeProblem, entries: Sequence[Entry]) -> list[list[int]]:
    """Numbers of the entries, by what is fitted apart: a group of joints each, or all where groups
    share a value.
    """
    if len(touched(problem, entries, problem.groups[0].joints)) == len(problem.groups):
        return [list(range(len(entries)))]
    return [inside(entries, [g]) for g in problem.groups]


def part_of(
    problem: TreeProblem, vector: Vector, some: Sequence[int]
) -> tuple[TreeProblem, Vector, list[int]]:
    """The problem of some groups only, their entries, and the numbers of these."""
    part = replace(problem, groups=tuple(problem.groups[k] for k in some))
    at = inside(vector.entries, part.groups)
    return part, Vector(tuple(vector.entries[i] for i in at), vector.values[at]), at


def put_back(
    vector: Vector, starts: Sequence[np.ndarray], at, some, values, own
) -> tuple[Vector, tuple[np.ndarray, ...]]:
    """Vector and starts of the whole with the values of the entries `at` and the starts `own` of
    the groups `some`.
    """
    every = vector.values.copy()
    every[at] = values
    new = dict(zip(some, own, strict=True))
    return vector.at(every), tuple(new.get(k, x) for k, x in enumerate(starts))


def linear_part(
    part: TreeProblem, lin: Linear, own: Vector, at: Sequence[int], some: Sequence[int]
) -> Linear:
    """Of a linearised fit what `part_of` has taken."""

    def pick(z):
        return tuple(z[k] for k in some)

    loss = np.sum(group_losses(part, [made.path for made in pick(lin.paths)], lin.fit.weights), 0)
    fit = replace(lin.fit, vector=own, starts=pick(lin.fit.starts), loss=loss)
    shared = tuple(s[..., at] for s in pick(lin.shared))
    own_paths, slopes, counted = pick(lin.paths), pick(lin.slopes), pick(lin.counted)
    return Linear(fit, pick(lin.residual), pick(lin.start), shared, own_paths, slopes, counted)


def held_out(
    problem: TreeProblem,
    lin: Linear,
    weights: Weights | None = None,
    like: FittedTree | None = None,
) -> HeldOut:
    """Each fold predicted with parameters from the others. like: a model whose predictions are
    taken for the groups of joints in which it is the same.
    """
    now = lin.fit
    weights = now.weights if weights is None else weights
    n = normal(problem, lin.residual, lin.start, lin.shared)
    steps = fold_steps(problem, n, now.vector)
    fold = padded_fold(problem, len(now.loss))
    rows = np.where(
        fold[:, None] >= 0, now.vector.values + steps[np.maximum(fold, 0)], now.vector.values
    )
    starts = [
        x + d
        for x, d in zip(
            now.starts, start_steps(problem, lin, rows - now.vector.values), strict=True
        )
    ]
    groups = range(len(problem.groups))
    free = len(by_group(problem, now.vector.entries)) == len(
        groups
    )  # else a shared value ties the folds' parameters together
    some = [k for k in groups if not (free and like and unchanged(problem, k, now, like.fit))]
    known = {} if like is None else dict(enumerate(like.held.paths))
    if some:
        part, own, at = part_of(problem, now.vector, some)
        options = [[z[k] for k in some] for z in (starts, now.starts)]
        paths = settled(
            part, linear_part(part, lin, own, at, some), own, options, rows[:, at], refine=2
        )[2]
        known |= dict(zip(some, paths, strict=True))
    selected = [known[k] for k in groups]
    loss, squared = losses(problem, selected, weights), squared_error(problem, selected)
    return HeldOut(loss, squared, now.vector.values + steps, n, tuple(selected))


def fold_steps(problem: TreeProblem, n: Normal, vector: Vector) -> np.ndarray:
    """Steps [F, P] from a fit to what the other folds say, by normal equations of each fold."""
    total = n.hess.sum(0)
    inside = (vector.values > vector.low) & (vector.values < vector.high)
    # one step from the fit, which is taken for the best there is (a step that gained nothing, where
    # dry friction bends the loss, no fold takes either), or for what its slope says of it (a fit
    # that a kink has stopped short): of both the shorter one. The prior holds at the fit, not at
    # what was declared: where only it decides, a fold has nothing else to say.
    prior = vector.precision * (vector.values - vector.start)
    slopes = np.where(inside, 0.0, n.slope.sum(0)) + prior, n.slope.sum(0) + prior

    def without(slope):
        return [
            vector.bounded_step(total - h, slope - s, 1e-9)
            for h, s in zip(n.hess, n.slope, strict=True)
        ]

    both = np.array([without(slope) for slope in slopes])
    hess, folds, steps = (
        total + np.diag(vector.precision),
        np.arange(len(n.hess)),
        np.zeros_like(both[0]),
    )
    for at in by_group(problem, vector.entries):
        length = np.einsum("mfp,pq,mfq->mf", both[..., at], hess[np.ix_(at, at)], both[..., at])
        steps[:, at] = both[np.argmin(length, 0), folds][:, at]

    # of what no other fold has seen (a stop, an angle) nothing is known without it
    def reported(h):
        return np.diagonal(h) + vector.precision

    alone = np.array(
        [reported(total - h) < CONFIRMATION.only_fold * reported(total) for h in n.hess]
    )
    return np.where(alone, np.array([e.off for e in vector.entries]) - vector.values, steps)


def squared_error(problem: TreeProblem, paths: Sequence[Path]) -> np.ndarray:
    """Mean square [W, 2n] over each stretch of what paths by group miss, angles and speeds."""
    n, columns = problem.joints, []
    for group, path in zip(problem.groups, paths, strict=True):
        observed = np.concatenate([group.stretches.seen, group.stretches.seen_v], 1)
        count = observed.transpose(2, 0, 1).sum(1)
        columns.append(np.square(residuals(group, path)).sum(1) / np.maximum(count, 1))
    out = np.zeros((len(columns[0]), 2 * n))
    for group, own in zip(problem.groups, columns, strict=True):
        j = np.array(group.joints)
        out[:, [*j, *(n + j)]] = own
    return out


def paired(problem: TreeProblem, without: np.ndarray, with_: np.ndarray) -> Test:
    """One model against another by their held-out losses [W] (one-sided: is the second better?):
    logarithms of each stretch's ratio, averaged over a fold or a block, so that no stretch that
    runs away decides for its trial. The test takes blocks of consecutive stretches: a few trials
    alone could not show what is not in each of them.
    """
    count = len(problem.fold)
    block = pieces(problem.groups[0].stretches.trial[:count], FOLD.test_pieces)
    return paired_test(without[:count], with_[:count], problem.fold, block)


def evenly_weighted(problem: TreeProblem, fitted: TreeFit, some: np.ndarray) -> TreeFit:
    """A fit in whose weights some stretches count as any other, up to those that are far off among
    them.
    """
    plain = replace(fitted.weights, stretch=np.ones_like(fitted.weights.stretch))
    loss = losses(problem, run(problem, fitted.vector, fitted.starts), plain)
    weight = 1.0 / np.maximum(1.0, loss / (STRETCH.outlying**2 * np.median(loss[some])))
    return replace(fitted, weights=replace(plain, stretch=weight), loss=loss * weight)


def modelled(
    problem: TreeProblem,
    added: Sequence[JointCandidate],
    fitted: TreeFit,
    weights: Weights | None = None,
    like: FittedTree | None = None,
) -> FittedTree:
    """A fit linearised and predicting. like: a model from which it differs in some groups of joints
    only: of the others its numbers are taken.
    """
    lin = linear(problem, fitted, like=like and like.lin)
    return FittedTree(tuple(added), fitted, lin, held_out(problem, lin, weights, like))


def refit(
    problem: TreeProblem,
    vector: Vector,
    starts,
    joints: Sequence[int],
    rounds: int,
    weights: Weights | None,
    glance: int | None = None,
) -> TreeFit:
    """A fit after something changed at `joints`: only in the groups of joints that this touches,
    where no value is shared.
    """
    some = touched(problem, vector.entries, joints)
    if weights is None or len(some) == len(problem.groups):
        return fit(problem, vector, starts, rounds=rounds, weights=weights, glance=glance)
    part, own, at = part_of(problem, vector, some)
    local = fit(part, own, [starts[k] for k in some], rounds=rounds, weights=weights, glance=glance)
    whole, starts = put_back(vector, starts, at, some, local.vector.values, local.starts)
    loss = losses(problem, run(problem, whole, starts), weights)
    return replace(local, vector=whole, starts=starts, loss=loss)


Begun = tuple[Vector, tuple[np.ndarray, ...], np.ndarray]


def attempted(problem: TreeProblem, base: FittedTree, reach: Reach, score: CandidateScore) -> Begun:
    """The base with a candidate added, one step on: vector, starts, and loss [W] of the best of a
    few lengths of the step.
    """
    c = score.candidate
    some = touched(problem, (*base.fit.vector.entries, *c.entries), c.joints)
    if len(some) < len(problem.groups):
        return _attempted_by_group(problem, base, reach, score, some)
    columns = candidate_columns(problem, base.lin, [(e, c.shaped()) for e in c.entries])
    wide = replace(
        base.lin,
        shared=tuple(
            np.concatenate([s, k], 2) for s, k in zip(base.lin.shared, columns, strict=True)
        ),
    )
    vector = base.fit.vector.with_entries(c.entries)
    n = normal(problem, wide.residual, wide.start, wide.shared)
    step = vector.bounded_step(n.hess.sum(0), n.slope.sum(0), 1e-6)
    shapes = shape_entries(problem, reach, c)
    own = np.array([e.owner == c.effect for e in vector.entries])
    # what sets in at a size of its own is nothing at a fifth of it: then the others' step is
    # shortened
    whole = own & problem.effect(c.effect).jump
    tries = [np.where(whole, step, length * step) for length in (1.0, 0.5, 0.2)]
    best = None
    for step in tries:
        moved = [
            x + d for x, d in zip(base.fit.starts, start_steps(problem, wide, step), strict=True)
        ]
        trial = vector.at(vector.values + step).with_entries(shapes)
        starts, by_lane, _ = settled(problem, base.lin, trial, (moved, base.fit.starts))
        if best is None or by_lane.sum() < best[2].sum():
            best = (trial, starts, by_lane)
        if by_lane.sum() < 0.9 * base.fit.total:
            break
    assert best is not None
    return best


def _attempted_by_group(
    problem: TreeProblem, base: FittedTree, reach: Reach, score: CandidateScore, some: Sequence[int]
) -> Begun:
    """The same in the groups that the candidate touches, the others being as they are."""
    part, own, at = part_of(problem, base.fit.vector, some)
    lin = linear_part(part, base.lin, own, at, some)
    new, local, loss = attempted(part, replace(base, fit=lin.fit, lin=lin), reach, score)
    known = len(own)  # what is added stands behind
    vector, starts = put_back(base.fit.vector, base.fit.starts, at, some, new.values[:known], local)
    vector = vector.with_entries(new.entries[known:], list(new.values[known:]))
    return vector, starts, base.fit.loss - lin.fit.loss + loss


def placed(
    problem: TreeProblem, base: FittedTree, reach: Reach, c: JointCandidate
) -> list[tuple[JointCandidate, Begun]]:
    """The base with an effect put in at each of its `starts`, nothing else changed, as `attempted`
    has it. Where the base is far off, only this shows what an effect does that acts now and then.
    """
    effect, joint = problem.effect(c.effect), c.joints[0]
    out = []
    for point in effect.starts(reach, joint) if effect.starts and len(c.joints) == 1 else ():
        at = {p.name: point[p.name] for p in effect.shapes if p.name in point}
        here = replace(
            c, shape=tuple(sorted((k, float(z)) for k, z in (at | _on_grid(effect, point)).items()))
        )
        vector = base.fit.vector.with_entries(c.entries)
        own = {e.key: float(point[e.name]) for e in c.entries}
        values = [own.get(e.key, z) for e, z in vector.pairs()]
        vector = vector.at(np.array(values)).with_entries(shape_entries(problem, reach, here))
        starts, by_lane, _ = settled(problem, base.lin, vector, (base.fit.starts,))
        out.append((here, (vector, starts, by_lane)))
    return out


def _on_grid(effect: Effect, point: Mapping[str, float]) -> dict[str, float]:
    """The amplitude too, of an effect whose grid has it."""
    if effect.jump:
        return {p.name: point[p.name] for p in effect.amplitudes if p.name in point}
    return {}
