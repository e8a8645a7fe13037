"""Output-error estimation: Gauss and Newton's steps, damped, over stretches with a free start each.

Channels are weighted by the size of their own residuals, so that radians, metres and their rates
need no common unit; a stretch that runs away counts less.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from adaptsim_jax.attribution.linear import Linear, linear, normal
from adaptsim_jax.attribution.parameters import Vector
from adaptsim_jax.attribution.paths import at_ends, ready, residuals, simulated, starts_of, widened
from adaptsim_jax.attribution.problem import Group, TreeProblem
from adaptsim_jax.attribution.simulate import Path
from adaptsim_jax.attribution.weights import TreeFit, Weights, group_losses, losses, weigh
from adaptsim_jax.diagnosis.steps import CONVERGED_GAIN, Point, fit_values

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
        moves = [
            refitted_start(x, mine.flat(residuals(g, p)), usual(problem, g))
            for g, (_, _, p), x, mine in zip(
                problem.groups, best, lin.start, lin.counted, strict=True
            )
        ]
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

    return (
        pick(new[0], old[0]),
        pick(new[1], old[1]),
        Path(*(pick(a, b) for a, b in zip(new[2], old[2], strict=True))),
    )


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
