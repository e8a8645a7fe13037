"""Output-error estimation: Gauss and Newton's steps, damped, over stretches with a free start each.

Channels are weighted by the size of their own residuals, so that radians, metres and their rates
need no common unit; a stretch that runs away counts less.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.linalg

from adaptsim_jax.attribution.linear import Linear, linear, normal
from adaptsim_jax.attribution.parameters import Vector
from adaptsim_jax.attribution.paths import at_ends, ready, residuals, simulated, starts_of, widened
from adaptsim_jax.attribution.problem import Group, Problem
from adaptsim_jax.attribution.simulate import Path
from adaptsim_jax.attribution.weights import Fit, Weights, group_losses, losses, weigh

CONVERGED = 1e-4  # share of the loss that a round takes off, below which a fit ends
GOING_ON = 0.03  # the same of a fit that is only to be compared


def _as_long(x: np.ndarray, rows: int) -> np.ndarray:
    """The first rows of x [R, W], with rows of zeros where it has fewer."""
    if len(x) >= rows:
        return x[:rows]
    return np.concatenate([x, np.zeros((rows - len(x), *x.shape[1:]))])


def bounded_step(hess: np.ndarray, slope: np.ndarray, vector: Vector, damping: float) -> np.ndarray:
    """Step [P] of the damped normal equations with the prior, within the bounds: entries that push
    against one stay.
    """
    prior = vector.precision
    hess = hess + np.diag(prior)
    slope = slope - prior * (vector.values - vector.start)
    low, high = vector.low - vector.values, vector.high - vector.values
    free = np.diagonal(hess) > 0.0
    step = np.zeros(len(slope))
    for _ in range(8):
        size = np.sqrt(np.maximum(np.diagonal(hess), 1e-300))
        scaled = hess / size / size[:, None]
        scaled[np.diag_indices_from(scaled)] += damping + 1e-10
        held = ~free
        right = (slope - hess[:, held] @ step[held]) / size
        if free.any():
            step[free] = _solved(scaled[np.ix_(free, free)], right[free]) / size[free]
        out = free & ((step < low) | (step > high))
        if not out.any():
            break
        step[out] = np.clip(step[out], low[out], high[out])
        free &= ~out
    return np.clip(step, low, high)


def _solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """By Cholesky's factors, or by least squares, many times the work, where rounding left the
    matrix without: of a parameter of which one fold says all, little but rounding is left without
    it.
    """
    try:
        return scipy.linalg.cho_solve(scipy.linalg.cho_factor(matrix), right)
    except np.linalg.LinAlgError:
        return np.linalg.lstsq(matrix, right, rcond=1e-12)[0]
    except (
        ValueError
    ):  # not finite: a simulation ran away beyond all numbers, and says nothing of where to go
        return np.zeros_like(right)


def start_steps(problem: Problem, lin: Linear, step: np.ndarray) -> list[np.ndarray]:
    """Change of the starts [2n, W] that goes with a step of the parameters: [P], or [W, P] for each
    stretch.
    """
    out = []
    for group, r, x, s in zip(problem.groups, lin.residual, lin.start, lin.shared, strict=True):
        left = r - (s @ (step if step.ndim == 1 else step[:, : s.shape[2], None])).reshape(r.shape)
        out.append(refitted_start(x, left, usual(problem, group)))
    return out


def usual(problem: Problem, group: Group) -> np.ndarray:
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
    problem: Problem,
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
    problem: Problem,
    vector: Vector,
    starts: Sequence[np.ndarray] | None = None,
    *,
    rounds: int = 12,
    weights: Weights | None = None,
    glance: int | None = None,
) -> Fit:
    """Fit the vector and all starts. weights: fixed ones (made anew along the way where None);
    glance: rounds after which a fit that is only to be compared ends once a round gains little.
    Codes: converged, stopped (rounds
    are used up), stuck (no step lowers the loss), diverged (the start itself runs away).
    """
    made = ready(problem, vector)
    starts = widened(made, starts_of(problem) if starts is None else starts)
    paths = simulated(made, starts)
    own = weights is None
    weights = weigh(problem, paths) if own else weights
    now = Fit(vector, starts, weights, losses(problem, paths, weights), "stopped", 0)
    damping = 1e-3
    for k in range(rounds):
        lin = linear(problem, now)
        n = normal(problem, lin.residual, lin.start, lin.shared)
        taken = None
        for _ in range(6):
            step = bounded_step(n.hess.sum(0), n.slope.sum(0), now.vector, damping)
            moves = start_steps(problem, lin, step)
            trial = now.vector.at(now.vector.values + step)
            moved = tuple(x + d for x, d in zip(now.starts, moves, strict=True))
            at, loss, paths = settled(problem, lin, trial, (moved, now.starts))
            if _cost(loss, trial) < _cost(now.loss, now.vector):
                taken = replace(now, vector=trial, starts=at, loss=loss, rounds=k + 1)
                break
            damping = max(10.0 * damping, 1e-3)
        if taken is None:
            return replace(now, code="converged" if k and damping > 1e2 else "stuck", rounds=k)
        fall = 1.0 - _cost(taken.loss, taken.vector) / max(_cost(now.loss, now.vector), 1e-300)
        now, damping = taken, max(0.1 * damping, 1e-8)
        if own:
            weights = weigh(problem, paths)
            now = replace(now, weights=weights, loss=losses(problem, paths, weights))
        if fall < (CONVERGED if glance is None or k + 1 < glance else GOING_ON):
            return replace(now, code="converged")
    return now


def _cost(loss: np.ndarray, vector: Vector) -> float:
    off = vector.values - vector.start
    return float(loss.sum() + 0.5 * np.sum(vector.precision * off * off))
