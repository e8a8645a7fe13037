"""Models of short trials: effects and their fit, compared on left-out trials, and scored for what
else would take something off.

The variance of a score is the residual's own, times the length over which residuals within a trial
hang together.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.fit import Fit, completed, fitted, jacobian, settled
from adaptsim_jax.diagnosis.problem import Problem
from adaptsim_jax.diagnosis.testing import (
    Test,
    best_of,
    correlated_rows,
    jackknife,
    paired_test,
    score_f,
)
from adaptsim_jax.effects.base import Effect


@dataclass(frozen=True)
class Score:
    """gain: share of the loss that one step would take off, shape by shape the best; p: of the F
    test of the best of its shapes.
    """

    candidate: Effect
    shape: dict[str, float]
    gain: float
    p: float


@dataclass(frozen=True)
class Model:
    """Effects in the model and its fit."""

    added: tuple[Effect, ...]
    fit: Fit


def paired(without: np.ndarray, with_: np.ndarray, problem: Problem | None = None) -> Test:
    """Whether the second model predicts trials better: mean squares `[T]` of each. Logarithms of
    the ratio are averaged over the problem's folds, and over its blocks for the test. Over trials
    where it has none.
    """
    if problem is None:
        return paired_test(without, with_)
    return paired_test(without, with_, problem.fold, problem.block)


def beats(problem: Problem, model: Model, other: Model, criteria: Criteria) -> bool:
    """Whether a model is to be taken instead of another: the one with fewer quantities, unless the
    larger holds out better. Among equals the better.
    """
    if len(model.fit.free) == len(other.fit.free):
        return paired(other.fit.held, model.fit.held, problem).gain > 0.0
    small, large = sorted((other, model), key=lambda m: len(m.fit.free))
    test = paired(small.fit.held, large.fit.held, problem)
    return (large if test.gain > criteria.size and test.p < criteria.confidence else small) is model


def begun_at(problem: Problem, values: np.ndarray, shape: Mapping[str, float]) -> np.ndarray:
    """Values `[P]` with those of a shape put in."""
    values = values.copy()
    for name, value in shape.items():
        values[problem.index[name]] = value
    return values


def added(problem: Problem, base: Model, score: Score, rounds: int) -> tuple[np.ndarray, float]:
    """The base with a candidate, fitted for so many rounds."""
    names = (*base.fit.free, *[q for q in score.candidate.names if q not in base.fit.free])
    return fitted(problem, names, begun_at(problem, base.fit.values, score.shape), rounds)


def finished(problem: Problem, effects, values, rounds: int) -> Model:
    names = list(problem.declared)
    for e in effects:
        names += [q for q in e.names if q not in names]
    return Model(
        tuple(effects), completed(problem, names, settled(problem, names, values, rounds)[0])
    )


def without(problem: Problem, model: Model, gone: Effect, rounds: int) -> Model:
    values = model.fit.values.copy()
    values[problem.at(gone.names)] = problem.neutral[problem.at(gone.names)]
    return finished(problem, [e for e in model.added if e is not gone], values, rounds)


def by_fold(problem: Problem, model: Model) -> np.ndarray:
    """Values `[F, P]` of a model without each fold."""
    if problem.fold is None:
        return model.fit.vectors
    return model.fit.vectors[np.unique(problem.fold, return_index=True)[1]]


def spread(problem: Problem, model: Model) -> np.ndarray:
    """Standard errors `[P]` by the jackknife over folds."""
    return jackknife(by_fold(problem, model))


def scored(problem: Problem, base: Model) -> list[Score]:
    """Every candidate that is not in the model, the best of its shapes, likeliest first."""
    remaining = [c for c in problem.effects if c not in base.added]
    left = _Left(problem, base.fit, _plain_columns(problem, base.fit, remaining))
    out = []
    for c in remaining:
        if set(c.names) <= set(base.fit.free):
            continue
        tried = [left.score(c, shape) for shape in c.points]
        out.append(max(tried, key=lambda s: s.gain))
    return sorted(out, key=lambda s: (s.p, -s.gain))


def _plain_columns(
    problem: Problem, fit: Fit, candidates: Sequence[Effect]
) -> dict[str, np.ndarray]:
    """Columns `[T, R]` of quantities that are freed where the model is, by name."""
    names = [q for c in candidates if {} in c.points for q in c.names if q not in fit.free]
    names = list(dict.fromkeys(names))
    if not names:
        return {}
    return dict(zip(names, np.moveaxis(jacobian(problem, fit.values, names), -1, 0), strict=True))


class _Left:
    """What a fit leaves, freed of what its own quantities would take up."""

    def __init__(self, problem: Problem, fit: Fit, columns: Mapping[str, np.ndarray]):
        self.problem, self.fit, self.columns = problem, fit, columns
        self.inner = _flat(fit.columns)
        self.gram = np.linalg.inv(self.inner.T @ self.inner + 1e-9 * np.eye(self.inner.shape[1]))
        self.rest = self.freed(fit.residual.reshape(-1))
        self.count = float(problem.counts.sum())
        self.lasting = correlated_rows(problem.by_channel(fit.residual))

    def freed(self, z: np.ndarray) -> np.ndarray:
        """Less what the fitted quantities take up."""
        return z - self.inner @ (self.gram @ (self.inner.T @ z))

    def score(self, c: Effect, shape: Mapping[str, float]) -> Score:
        """One step's gain of a candidate at a shape, and its F test, for all shapes that it has."""
        columns = self.freed(self.columns_of(c, shape))
        square, slope = columns.T @ columns, columns.T @ self.rest
        ridge = (1e-6 + 1e-9 * np.trace(square)) * np.eye(len(square))
        gain = float(slope @ np.linalg.solve(square + ridge, slope))
        k, free, loss = len(c.names), len(self.fit.free), self.fit.loss
        p = best_of(score_f(gain, loss, self.count, k, free, self.lasting), len(c.points))
        return Score(c, dict(shape), gain / max(loss, 1e-12), p)

    def columns_of(self, c: Effect, shape: Mapping[str, float]) -> np.ndarray:
        """`[T R, K]`; of what is all shape the whole step there."""
        problem, fit = self.problem, self.fit
        names = [q for q in c.names if q not in shape and q not in fit.free]
        if names and not shape:
            return _flat(np.stack([self.columns[q] for q in names], -1))
        values = begun_at(problem, fit.values, shape)
        if names:
            return _flat(jacobian(problem, values, names))
        step = fit.residual - problem.residuals(np.tile(values, (len(problem.trials), 1)))
        return step.reshape(-1, 1)


def _flat(columns: np.ndarray) -> np.ndarray:
    return columns.reshape(columns.shape[0] * columns.shape[1], columns.shape[2])
