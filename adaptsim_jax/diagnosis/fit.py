"""Least squares over trials (Levenberg and Marquardt within bounds), and each trial predicted by
the others.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from adaptsim_jax.diagnosis.criteria import RESTART
from adaptsim_jax.diagnosis.problem import Problem
from adaptsim_jax.diagnosis.steps import FitEnd, Point, bounded_step, fit_values

MAX_START_GROUPS = 4  # groups of starts that the declared fit may begin from, one after the other


@dataclass(frozen=True)
class Fit:
    """values `[P]`; free: names of what was fitted; residual `[T, R]`; columns `[T, R, K]` in steps
    of each quantity's scale; loss: sum of squares; held: mean square `[T]` of each trial, predicted
    by the others; vectors `[T, P]`: with what.
    """

    values: np.ndarray
    free: tuple[str, ...]
    residual: np.ndarray
    columns: np.ndarray
    loss: float
    held: np.ndarray
    vectors: np.ndarray


def mean_square(problem: Problem, residual: np.ndarray) -> np.ndarray:
    """Mean square `[T]` of residuals `[T, R]`."""
    return np.square(residual).sum(1) / np.maximum(problem.counts, 1)


def jacobian(problem: Problem, values: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """Columns `[T, R, K]` of `names`, each in steps of its scale."""
    at = problem.at(names)
    basis = np.zeros((len(at), len(problem.quantities)))
    basis[np.arange(len(at)), at] = [problem.quantities[i].scale for i in at]
    return problem.columns(values, basis)


def fitted(
    problem: Problem, names: Sequence[str], values: np.ndarray, rounds: int
) -> tuple[np.ndarray, float]:
    """`names` fitted from `values [P]` for at most so many rounds: values and the loss."""
    point = reached(problem, names, values, rounds).point
    return point.state[0], point.loss


def reached(problem: Problem, names: Sequence[str], values: np.ndarray, rounds: int) -> FitEnd:
    """Where the same fit ends, and how; a point's state is its values and what they leave."""
    count = len(problem.trials)

    def at(values: np.ndarray) -> Point:
        residual = problem.residuals(np.tile(values, (count, 1)))
        return Point(float(np.square(residual).sum()), (values, residual))

    def around(point: Point) -> Callable[[float], Point]:
        values, residual = point.state
        columns = jacobian(problem, values, names)
        hess = np.einsum("trk,trl->kl", columns, columns)
        slope = np.einsum("trk,tr->k", columns, residual)
        # far from the noise a step is trusted less
        excess = max(1.0, point.loss / max(problem.counts.sum(), 1))
        return lambda damping: at(bounded(problem, names, values, hess, slope, damping * excess))

    return fit_values(at(values.copy()), around, rounds, damping=0.0, relief=0.0)


def settled(
    problem: Problem, names: Sequence[str], values: np.ndarray, rounds: int
) -> tuple[np.ndarray, float]:
    """As `fitted`; where structure is left, also from beside in each of `problem.again`, the best
    two of them to the end.

    A push that runs along a patch's edge makes minima a few millimetres from each other, and an
    effect would be judged by its own.
    """
    best = fitted(problem, names, values, rounds)
    if best[1] <= RESTART.fit_noises**2 * problem.counts.sum():
        return best
    tries = []
    for i in problem.at(problem.again):
        q = problem.quantities[i]
        for side in (-q.scale, q.scale):
            moved = best[0].copy()
            moved[i] = np.clip(moved[i] + side, q.low, q.high)
            tries.append(fitted(problem, names, moved, 2))
    for moved, _ in sorted(tries, key=lambda t: t[1])[:2]:
        best = min(best, fitted(problem, names, moved, rounds), key=lambda t: t[1])
    return best


def bounded(problem: Problem, names, values, hess, slope, damping: float = 0.0) -> np.ndarray:
    """Gauss and Newton's step with priors, what would leave its bounds held at them; `values [P]`
    after it.
    """
    at = problem.at(names)
    q = [problem.quantities[i] for i in at]
    scale = np.array([z.scale for z in q])
    low, high = (np.array([getattr(z, end) for z in q]) for end in ("low", "high"))
    prior = scale / np.array([z.prior for z in q])
    now, neutral = values[at], np.array([z.default for z in q])
    slope = slope - prior**2 * (now - neutral) / scale
    ends = (low - now) / scale, (high - now) / scale
    step = bounded_step(hess + np.diag(prior**2), slope, *ends, damping)
    moved = values.copy()
    moved[at] = np.clip(now + scale * step, low, high)
    return moved


def completed(problem: Problem, names: Sequence[str], values: np.ndarray) -> Fit:
    """A fit with its linearisation, and each trial simulated with what the others say (one step
    from the whole fit).
    """
    count = len(problem.trials)
    residual = problem.residuals(np.tile(values, (count, 1)))
    columns = jacobian(problem, values, names)
    hess = np.einsum("trk,trl->tkl", columns, columns)
    slope = np.einsum("trk,tr->tk", columns, residual)
    whole = bounded(problem, names, values, hess.sum(0), slope.sum(0))
    fold = np.arange(count) if problem.fold is None else problem.fold
    inside = [fold == k for k in range(fold.max() + 1)]

    def less(z, mine):
        return z.sum(0) - z[mine].sum(0)

    out = np.array(
        [bounded(problem, names, values, less(hess, mine), less(slope, mine)) for mine in inside]
    )
    low, high = (np.array([getattr(q, end) for q in problem.quantities]) for end in ("low", "high"))
    vectors = np.clip(values + out[fold] - whole, low, high)
    held = mean_square(problem, problem.residuals(vectors))
    loss = float(np.square(residual).sum())
    return Fit(values, tuple(names), residual, columns, loss, held, vectors)


def declared_fit(problem: Problem, rounds: int, noise: float = np.inf) -> Fit:
    """The declared quantities fitted from the best few of `problem.starts`, and from more of them
    while more than `noise` (mean square) is left: a bad minimum looks like an effect.
    """

    def squares(values: np.ndarray) -> float:
        every = np.tile(values, (len(problem.trials), 1))
        return np.square(problem.residuals(every)).sum()

    score = problem.scan or (lambda rows: np.array([squares(v) for v in rows]))
    order, fits = np.argsort(score(problem.starts)), []
    for first in range(0, MAX_START_GROUPS * problem.begun, problem.begun):
        fits += [
            fitted(problem, problem.declared, problem.starts[i], rounds)
            for i in order[first : first + problem.begun]
        ]
        best, loss = min(fits, key=lambda f: f[1])
        if loss < noise * problem.counts.sum():
            break
    return completed(problem, problem.declared, settled(problem, problem.declared, best, rounds)[0])
