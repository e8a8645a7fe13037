"""Output-error estimation: Gauss and Newton's steps, damped, over stretches with a free start each.

Channels are weighted by the size of their own residuals, so that radians, metres and their rates
need no common unit; a stretch that runs away counts less.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.attribution.columns import GroupColumns, Shapes
from adaptsim_jax.attribution.parameters import Entry, Normal, TreeFit, Vector, Weights
from adaptsim_jax.attribution.paths import (
    Counted,
    at_ends,
    counted,
    group_losses,
    losses,
    ready,
    residuals,
    simulated,
    starts_of,
    weigh,
    widened,
)
from adaptsim_jax.attribution.problem import Group, TreeProblem
from adaptsim_jax.attribution.simulate import Path, linearise, respond, responded_start
from adaptsim_jax.diagnosis.steps import CONVERGED_GAIN, Point, fit_values

# derivatives of a stretch from which on it says nothing: far beyond any that a weight and a unit
# make
MAX_DERIVATIVE = 1e30


@dataclass(frozen=True)
class Linear:
    """A fit linearised. By group: residual [W, R], start and parameter columns [W, R, 2n], [W, R,
    P]; weights in all of them.
    """

    fit: TreeFit
    residual: tuple[np.ndarray, ...]
    start: tuple[np.ndarray, ...]
    shared: tuple[np.ndarray, ...]
    paths: tuple[GroupColumns, ...]
    slopes: tuple[tuple[np.ndarray, np.ndarray], ...]
    counted: tuple[Counted, ...]


def inside(entries: Sequence[Entry], groups: Iterable[Group]) -> list[int]:
    """Numbers of the entries that act in some groups."""
    joints = {j for g in groups for j in g.joints}
    return [i for i, e in enumerate(entries) if set(e.joints) & joints]


def unchanged(problem: TreeProblem, k: int, new: TreeFit, old: TreeFit) -> bool:
    """Whether all that a group depends on is the same in two fits."""

    def own(f):
        return {
            f.vector.entries[i].key: f.vector.values[i]
            for i in inside(f.vector.entries, [problem.groups[k]])
        }

    return (
        new.weights is old.weights
        and np.array_equal(new.starts[k], old.starts[k])
        and own(new) == own(old)
    )


def linear(
    problem: TreeProblem,
    fit: TreeFit,
    entries: Sequence[Entry] | None = None,
    like: "Linear | None" = None,
) -> Linear:
    """Linearise a fit, by the starts and by `entries` (those of its vector where None). like: a fit
    linearised, of which what is the same is taken.
    """
    entries = fit.vector.entries if entries is None else entries
    residual, start, shared, columns, slopes, sums = [], [], [], [], [], []
    same = [
        like is not None and unchanged(problem, k, fit, like.fit)
        for k in range(len(problem.groups))
    ]
    changed = [k for k, known in enumerate(same) if not known]
    with jax.enable_x64(True):
        made = ready(replace(problem, groups=tuple(problem.groups[k] for k in changed)), fit.vector)
        fresh = iter(zip(made, widened(made, [fit.starts[k] for k in changed]), strict=True))
        for k, known in enumerate(same):
            if like is not None and known:
                residual.append(like.residual[k])
                start.append(like.start[k])
                columns.append(like.paths[k])
                slopes.append(like.slopes[k])
                sums.append(like.counted[k])
                shared.append(_reordered(like.shared[k], like.fit.vector.entries, entries))
                continue
            (group, values, _, how), x0 = next(fresh)
            s = group.stretches
            path, a, f = linearise(group.model, values, s.time, s.stamp, s.command, x0, how)
            path = Path(*(np.asarray(z) for z in path))
            by_state, by_force = (
                np.array(np.asarray(z).transpose(3, 0, 1, 2), order="C") for z in (a, f)
            )
            slope = (by_state, by_force)
            own = GroupColumns(problem, group, fit.vector, jax.tree.map(jnp.asarray, values), path)
            mine = counted(problem, group, fit.weights)
            residual.append(mine.flat(residuals(group, path)))
            n, g = len(group.joints), how.giving
            free = np.concatenate([np.arange(2 * n), 2 * n + g, 3 * n + g])
            by_start = np.zeros((*residual[-1].shape, len(x0)))
            by_start[..., free] = mine.weigh(
                responded_start(by_state, len(free), mine.rows, mine.channels)
            )
            start.append(by_start)
            columns.append(own)
            slopes.append(slope)
            sums.append(mine)
            shared.append(_output(own, slope, [(e, None) for e in entries], mine))
            _without_lost(residual[-1], start[-1], shared[-1], *slope)
    return Linear(
        fit,
        tuple(residual),
        tuple(start),
        tuple(shared),
        tuple(columns),
        tuple(slopes),
        tuple(sums),
    )


def _reordered(columns: np.ndarray, known: Sequence[Entry], entries: Sequence[Entry]) -> np.ndarray:
    """Columns [W, R, K] of other entries than they were made for; zero of those that are new, which
    act elsewhere.
    """
    at = {e.key: i for i, e in enumerate(known)}
    out = np.zeros((*columns.shape[:2], len(entries)))
    both = [(i, at[e.key]) for i, e in enumerate(entries) if e.key in at]
    out[..., [i for i, _ in both]] = columns[..., [i for _, i in both]]
    return out


def _without_lost(*by_lane: np.ndarray) -> None:
    """Stretches [W, ...] that ran away say nothing of where to go: their rows become zero, in
    place. Finite numbers may be too large for their squares, too.
    """
    lost = ~np.all([(np.abs(z) < MAX_DERIVATIVE).reshape(len(z), -1).all(1) for z in by_lane], 0)
    for z in by_lane if lost.any() else ():
        z[lost] = 0.0


def _output(
    made: GroupColumns, slope: tuple[np.ndarray, np.ndarray], entries, mine: Counted
) -> np.ndarray:
    """Output columns [W, R, K]; zero, at no cost, for entries of other groups."""
    own = inside([e for e, _ in entries], [made.group])
    out = np.zeros((len(mine.weight), mine.weight[0].size, len(entries)))
    for first in range(0, len(own), 48):
        some = own[first : first + 48]
        force, output = made.stack([entries[k] for k in some])
        y = respond(*slope, force, mine.rows, mine.channels)
        if output is not None:
            y += mine.pick(output)
        whole = some == list(
            range(some[0], some[0] + len(some))
        )  # neighbours, as with one group all are
        out[..., slice(some[0], some[0] + len(some)) if whole else some] = mine.weigh(y)
    return out


def candidate_columns(
    problem: TreeProblem, lin: Linear, entries: Sequence[tuple[Entry, Shapes | None]]
) -> list[np.ndarray]:
    """Output columns [W, R, K] of more parameters, by group, weighted as those of `lin`. Those of
    drives that would give are freed of how these swing from a start that nobody knows.
    """
    out = []
    for group, made, slope, start, mine in zip(
        problem.groups, lin.paths, lin.slopes, lin.start, lin.counted, strict=True
    ):
        columns = _output(made, slope, list(entries), mine)
        for k, (e, shape) in enumerate(entries):
            effect = problem.effect(e.owner)
            if (
                effect.place == "drive"
                and shape
                and e.name in shape
                and e.joints[0] in group.joints
            ):
                at = [group.joints.index(e.joints[0]) + n for n in (0, made.n)]
                swings = np.zeros((len(start), made.path.x.shape[0], 2 * made.n, 2))
                swings[:, :, at] = made.alone(effect, e.name, shape)[1:, :, at].transpose(
                    3, 1, 2, 0
                )
                both = np.concatenate([start, mine.flat(swings)], 2)
                columns[..., k : k + 1] = project(both, columns[..., k : k + 1])[0]
        out.append(columns)
    return out


def project(start: np.ndarray, *columns: np.ndarray) -> list[np.ndarray]:
    """Columns [W, R, .] less what the free starts explain of them."""
    scale = np.sqrt(np.square(start).sum(1, keepdims=True))
    q, r = np.linalg.qr(start / np.where(scale > 0, scale, 1.0))
    good = (np.abs(np.diagonal(r, axis1=1, axis2=2)) > 1e-9)[:, None, :]
    q = q * good
    return [c - q @ (np.swapaxes(q, 1, 2) @ c) for c in columns]


def normal(problem: TreeProblem, residual: Sequence[np.ndarray], start, shared) -> Normal:
    """Summed over groups, by fold."""
    count, folds = shared[0].shape[2], len(problem.folds)
    hess, slope = np.zeros((folds, count, count)), np.zeros((folds, count))
    for r, x, s in zip(residual, start, shared, strict=True):
        live = np.flatnonzero(np.any(s, axis=(0, 1)))
        rp, sp = project(x, r[..., None], s if len(live) == count else s[..., live])
        fold = padded_fold(problem, len(r))
        for k in range(folds):
            mine = rows(sp[fold == k])
            hess[k][np.ix_(live, live)] += mine.T @ mine
            slope[k][live] += mine.T @ rp[fold == k].reshape(-1)
    return Normal(hess, slope)


def rows(columns: np.ndarray) -> np.ndarray:
    """[W, R, K] as [W R, K]."""
    return columns.reshape(columns.shape[0] * columns.shape[1], columns.shape[2])


def padded_fold(problem: TreeProblem, width: int) -> np.ndarray:
    if width > len(problem.fold):
        return np.concatenate([problem.fold, np.full(width - len(problem.fold), -1)])
    return problem.fold


# share of the loss that a round must take off a fit that is only to be compared
COMPARED_GAIN = 0.03


def _as_long(x: np.ndarray, rows: int) -> np.ndarray:
    """The first rows of x [R, W], with rows of zeros where it has fewer."""
    if len(x) >= rows:
        return x[:rows]
    return np.concatenate([x, np.zeros((rows - len(x), *x.shape[1:]))])


def start_steps(problem: TreeProblem, lin: Linear, step: np.ndarray) -> list[np.ndarray]:
    """Change of the starts [2n, W] that goes with a step of the parameters: [P], or [W, P] for each
    stretch.
    """
    out = []
    for group, r, x, s in zip(problem.groups, lin.residual, lin.start, lin.shared, strict=True):
        left = r - (s @ (step if step.ndim == 1 else step[:, : s.shape[2], None])).reshape(r.shape)
        out.append(refitted_start(x, left, usual(problem, group)))
    return out


def usual(problem: TreeProblem, group: Group) -> np.ndarray:
    """How far a start [2n] may be off as easily as a row by what is left of it: an angle by the
    range of the motion, a speed by the usual one. A servo forgets at which speed it began before
    the second row, and any would do.
    """
    r, j = problem.reach, list(group.joints)
    return np.concatenate([(r.q_high - r.q_low)[j] + 1e-3, r.speed[j]])


def refitted_start(start: np.ndarray, left: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Least-squares change of the starts [S, W] for residuals [W, R] by their derivatives [W, R,
    S]; size: as of `usual`.
    """
    prior = np.zeros(start.shape[2])
    prior[: len(size)] = size**-2.0
    prior = np.square(left).mean(1)[:, None] * prior
    scale = np.sqrt(np.square(start).sum(1) + prior)
    scale = np.where(scale > 0, scale, 1.0)
    x = start / scale[:, None]
    normal = np.swapaxes(x, 1, 2) @ x + 1e-9 * np.eye(x.shape[2])
    normal[:, np.arange(x.shape[2]), np.arange(x.shape[2])] += prior / scale**2
    return (np.linalg.solve(normal, np.swapaxes(x, 1, 2) @ left[..., None])[..., 0] / scale).T


def settled(
    problem: TreeProblem,
    lin: Linear,
    vector: Vector,
    options: Sequence[Sequence[np.ndarray]],
    rows: np.ndarray | None = None,
    refine: int = 1,
) -> tuple[tuple[np.ndarray, ...], np.ndarray, list[Path]]:
    """Starts, loss [W] and paths at given parameters: of the options stretch by stretch the better,
    refined `refine` times by least squares with the derivatives of `lin`. A stretch that sticks and
    slips need not follow them: no step is taken on trust.
    """
    made = ready(problem, vector, rows)
    best: list = []  # by group: starts, loss, path

    def offer(starts: Sequence[np.ndarray]) -> None:
        starts = widened(made, starts)
        paths = simulated(made, starts)
        new = list(zip(starts, group_losses(problem, paths, lin.fit.weights), paths, strict=True))
        if best:
            best[:] = [_better(*both) for both in zip(new, best, strict=True)]
        else:
            best[:] = new

    for starts in (*options, *at_ends(made)):
        offer(starts)
    for _ in range(refine):
        moves = []
        for g, new, x, mine in zip(problem.groups, best, lin.start, lin.counted, strict=True):
            left = mine.flat(residuals(g, new[2]))
            moves.append(refitted_start(x, left, usual(problem, g)))
        offer([x + _as_long(d, len(x)) for (x, _, _), d in zip(best, moves, strict=True)])
    starts, loss, paths = zip(*best, strict=True)
    return starts, np.sum(loss, 0), list(paths)


def _better(new: tuple, old: tuple) -> tuple:
    """Starts [2n, W], loss [W] and path of two simulations of a group, stretch by stretch those
    with less loss.
    """
    good = new[1] < old[1]

    def pick(a, b):
        return np.where(good, a, b)

    path = Path(*(pick(a, b) for a, b in zip(new[2], old[2], strict=True)))
    return pick(new[0], old[0]), pick(new[1], old[1]), path


def fit(
    problem: TreeProblem,
    vector: Vector,
    starts: Sequence[np.ndarray] | None = None,
    *,
    rounds: int = 12,
    weights: Weights | None = None,
    glance: int | None = None,
) -> TreeFit:
    """Fit the vector and all starts.

    Args:
        problem: Stretches of each group of joints.
        vector: Where the values begin.
        starts: Where those of the stretches begin. The smoothed ones where None.
        rounds: Of steps at most.
        weights: Fixed ones; made anew along the way where None.
        glance: Rounds after which a fit that is only to be compared ends once a round gains
            little.
    """
    made = ready(problem, vector)
    starts = widened(made, starts_of(problem) if starts is None else starts)
    paths = simulated(made, starts)
    fixed = weights
    weights = weigh(problem, paths) if fixed is None else fixed
    begun = TreeFit(vector, starts, weights, losses(problem, paths, weights), "stopped", 0)

    def around(point: Point) -> Callable[[float], Point]:
        now = point.state[0]
        lin = linear(problem, now)
        n = normal(problem, lin.residual, lin.start, lin.shared)
        hess, slope = n.hess.sum(0), n.slope.sum(0)
        return lambda damping: _moved(problem, lin, now.vector.bounded_step(hess, slope, damping))

    def taken(point: Point) -> Point:
        now, paths = point.state
        if fixed is not None:
            return point
        weights = weigh(problem, paths)
        return _point(replace(now, weights=weights, loss=losses(problem, paths, weights)), paths)

    def done(before: Point, after: Point, k: int) -> bool:
        minimum = CONVERGED_GAIN if glance is None or k < glance else COMPARED_GAIN
        return before.loss - after.loss < minimum * max(before.loss, 1e-300)

    found = fit_values(_point(begun, paths), around, rounds, done=done, taken=taken)
    return replace(found.point.state[0], code=found.code, rounds=found.rounds)


def _moved(problem: TreeProblem, lin: Linear, step: np.ndarray) -> Point:
    """Where a step of the parameters [P] leads, with starts that belong to it."""
    now = lin.fit
    moves = start_steps(problem, lin, step)
    vector = now.vector.at(now.vector.values + step)
    moved = tuple(x + d for x, d in zip(now.starts, moves, strict=True))
    starts, loss, paths = settled(problem, lin, vector, (moved, now.starts))
    return _point(replace(now, vector=vector, starts=starts, loss=loss), paths)


def _point(fit: TreeFit, paths: Sequence[Path]) -> Point:
    """A fit and its paths, with the loss and the prior's."""
    off = fit.vector.values - fit.vector.start
    return Point(
        float(fit.loss.sum() + 0.5 * np.sum(fit.vector.precision * off * off)), (fit, paths)
    )
