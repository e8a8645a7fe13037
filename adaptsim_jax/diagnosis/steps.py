"""Gauss and Newton's steps: within bounds, damped, of values that all stretches share and of starts
that each has for itself.

Functions take arrays and callables and know no problem, so that every simulator is fitted by the
same two loops (Levenberg, 1944; Marquardt, 1963).
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg

RIDGE = 1e-10  # of the diagonal, added always: two columns that are alike are no error
DAMPING_UP = 10.0  # times the damping after a step in vain: a decade is searched quickly
FIRST_DAMPING = 1e-3  # of the diagonal: the first damping, and the least after a step in vain
DAMPING_DOWN = 0.1  # times the damping after a step that gained
MIN_DAMPING = 1e-8  # of the diagonal: the least damping after a step that gained
MAX_DAMPING = 1e2  # of the diagonal: damping beyond which no step that could matter is left
CONVERGED_GAIN = 1e-4  # share of the loss that a round takes off, below which a fit has converged
MAX_DAMPINGS = 6  # dampings of a round
MIN_FALL = 1e-9  # of the largest slope: a held number by which the loss falls less is not released
MAX_RELEASES = 3  # of each number, after which rounding keeps them from ending


class NotFinite(ArithmeticError):
    """Normal equations with a number that is not finite: a simulation ran away, and no step
    follows.
    """


def bounded_step(
    hess: np.ndarray,
    slope: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    damping: float = 0.0,
) -> np.ndarray:
    """Step [P] that lowers a damped quadratic loss the most between its bounds.

    What would leave a bound is held at it, and released where the loss then falls inwards, until
    none does (the conditions of Karush, Kuhn and Tucker; bounded-variable least squares, Stark and
    Parker, 1995).

    Args:
        hess: curvature [P, P], with that of a prior. Numbers without any do not move.
        slope: fall of the loss by each number [P].
        low: of the step [P], at most zero.
        high: of the step [P], at least zero.
        damping: share of the diagonal that is added to it.

    Raises:
        NotFinite: curvature or slope is not finite.
    """
    if not (np.all(np.isfinite(hess)) and np.all(np.isfinite(slope))):
        raise NotFinite("a step's equations have numbers that are not finite")
    size = np.sqrt(np.maximum(np.diagonal(hess), 1e-300))
    matrix = hess / size / size[:, None]
    matrix[np.diag_indices_from(matrix)] += damping + RIDGE
    right, floor, top = slope / size, low * size, high * size
    free = np.diagonal(hess) > 0.0
    movable = free & (floor < top)
    step = np.zeros(len(slope))
    while True:
        step[free] = _least(matrix, right, step, free)
        out = free & ((step < floor) | (step > top))
        if not out.any():
            break
        step[out] = np.clip(step[out], floor[out], top[out])
        free &= ~out
    enough = MIN_FALL * np.max(np.abs(right), initial=0.0)
    for _ in range(MAX_RELEASES * len(step)):
        fall = right - matrix @ step
        inward = np.where(step <= floor, fall, -fall)
        gain = np.where(movable & ~free, inward, 0.0)
        if not np.any(gain > enough):
            break
        free[np.argmax(gain)] = True
        step, free = _moved(matrix, right, step, free, floor, top)
    return np.clip(step / size, low, high)


def _least(matrix: np.ndarray, right: np.ndarray, at: np.ndarray, free: np.ndarray) -> np.ndarray:
    """The free numbers [F] at which the loss is least, the others held where they are `at` [P]."""
    held = ~free
    own = right[free] - matrix[np.ix_(free, held)] @ at[held]
    return solve(matrix[np.ix_(free, free)], own)


def _moved(matrix, right, at, free, low, high) -> tuple[np.ndarray, np.ndarray]:
    """Step [P] and what is free of it [P], after going to the least loss of what is free: what
    meets a bound on the way is held there.
    """
    at, free = at.copy(), free.copy()
    while free.any():
        way = np.zeros_like(at)
        way[free] = _least(matrix, right, at, free) - at[free]
        room = np.full_like(at, np.inf)
        np.divide(np.where(way > 0.0, high, low) - at, way, out=room, where=way != 0.0)
        share = min(1.0, room.min())
        at += share * way
        met = room <= share
        if share == 1.0:
            break
        at[met] = np.where(way > 0.0, high, low)[met]
        free &= ~met
    return at, free


def solve(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """By Cholesky's factors; by least squares, many times the work, where rounding left none.

    Without the one fold that tells of a number, little but rounding is left of its row.
    """
    try:
        factor = scipy.linalg.cho_factor(matrix, check_finite=False)
        return scipy.linalg.cho_solve(factor, right, check_finite=False)
    except np.linalg.LinAlgError:
        return np.linalg.lstsq(matrix, right, rcond=1e-12)[0]


class Point(NamedTuple):
    """Where a fit stands: its loss, and what the caller knows there (values, starts, paths)."""

    loss: float
    state: Any


class FitEnd(NamedTuple):
    """Where a fit ended after so many rounds. code: converged, stopped (rounds are used up) or
    stuck (no step lowers the loss).
    """

    point: Point
    code: str
    rounds: int


def fell(before: Point, after: Point, rounds: int) -> bool:
    """Whether a round gained so little that a fit has converged."""
    return before.loss - after.loss < CONVERGED_GAIN * max(before.loss, 1e-300)


def fit_values(
    point: Point,
    around: Callable[[Point], Callable[[float], Point]],
    rounds: int,
    damping: float = FIRST_DAMPING,
    relief: float = DAMPING_DOWN,
    done: Callable[[Point, Point, int], bool] = fell,
    taken: Callable[[Point], Point] = lambda point: point,
) -> FitEnd:
    """Damped steps of values, each from a linearisation, while they lower the loss.

    Args:
        point: where the fit begins.
        around: linearises at a point. What it returns takes a step with a damping.
        rounds: linearisations at most.
        damping: of the first step.
        relief: times the damping after a step that gained.
        done: whether the second point after so many rounds is good enough for an end.
        taken: what becomes of a point that was taken (new weights).
    """
    for k in range(rounds):
        step, trial = around(point), None
        for _ in range(MAX_DAMPINGS):
            try:
                tried = step(damping)
            except NotFinite:
                break
            if tried.loss < point.loss:
                trial = tried
                break
            damping = max(DAMPING_UP * damping, FIRST_DAMPING)
        if trial is None:
            return FitEnd(point, "converged" if k and damping > MAX_DAMPING else "stuck", k)
        ended = done(point, trial, k + 1)
        point, damping = taken(trial), max(relief * damping, MIN_DAMPING)
        if ended:
            return FitEnd(point, "converged", k + 1)
    return FitEnd(point, "stopped", rounds)


class StretchLanes(NamedTuple):
    """Starts of stretches [W, S], what they leave [W, ...], and the loss of each [W]."""

    starts: np.ndarray
    left: np.ndarray
    loss: np.ndarray


Evaluate = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Starts [B, S] of the stretches [B] to what they leave [B, ...] and the loss of each [B]."""


def best_of(options: Sequence[np.ndarray], evaluate: Evaluate) -> StretchLanes:
    """Of several starts [W, S] of all stretches, stretch by stretch the one with the least loss."""
    lanes = np.arange(len(options[0]))
    best = StretchLanes(options[0].copy(), *evaluate(options[0], lanes))
    for starts in options[1:]:
        left, loss = evaluate(starts, lanes)
        better = loss < best.loss
        for mine, other in zip(best, (starts, left, loss), strict=True):
            mine[better] = other[better]
    return best


def fit_starts(
    begun: StretchLanes,
    propose: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray],
    evaluate: Evaluate,
    rounds: int,
    enough: float = CONVERGED_GAIN,
    lanes: np.ndarray | None = None,
    every: bool = False,
) -> StretchLanes:
    """Starts fitted with all values held, each stretch by itself until a round gains it little.

    Args:
        begun: where the fit begins.
        propose: starts [B, S], what they leave and their stretches [B] to starts [T, B, S] to try,
            the boldest first.
        evaluate: what starts leave.
        rounds: of proposals at most.
        enough: share of its loss that a round must take off a stretch for another.
        lanes: stretches that are fitted; all where None.
        every: whether a stretch takes the best of all proposals, and not the first that lowers its
            loss (where contact bends it, the first may be a small part of what can be had).
    """
    starts, left, loss = (z.copy() for z in begun)
    on = np.arange(len(loss)) if lanes is None else lanes
    for _ in range(rounds):
        if not len(on):
            break
        before, rest = loss[on].copy(), np.arange(len(on))
        for tried in propose(starts[on], left[on], on):
            fresh, now = evaluate(tried[rest], on[rest])
            good = now < loss[on[rest]]
            took = on[rest[good]]
            starts[took], left[took], loss[took] = tried[rest[good]], fresh[good], now[good]
            rest = rest if every else rest[~good]
            if not len(rest):
                break
        on = on[before - loss[on] > enough * before]
    return StretchLanes(starts, left, loss)
