"""The error before and after, always of simulated data that were not fitted.

Each fold's trials are left out of the shared parameters in turn; only their initial states are fitted to them, by least
squares, so that a window's error is what its dynamics get wrong and not how its start was weighted. Errors
are in radians, root mean square over the rows of windows simulated from those states, with an interval over trials.
"""

from dataclasses import dataclass

import numpy as np

from adaptsim_jax.core.parallel import parallel_map
from adaptsim_jax.logs.segments import folds
from adaptsim_jax.sysid.criteria import Criteria
from adaptsim_jax.sysid.estimate import variance
from adaptsim_jax.sysid.estimate.candidate import refit_more
from adaptsim_jax.sysid.estimate.fitted import Fit
from adaptsim_jax.sysid.estimate.problem import Problem, initial_states
from adaptsim_jax.sysid.score.table import ScoreTable


@dataclass(frozen=True)
class CrossValidation:
    """Held-out simulation of one model. simulated `[W, L+1, Y]` rad (NaN in padding); squared `[W, Y]` sum of squared
    errors and count `[W, Y]` of rows; trial `[W]`; fold `[W]`."""

    simulated: np.ndarray
    squared: np.ndarray
    count: np.ndarray
    trial: np.ndarray
    fold: np.ndarray

    def rmse(self, channel: int | None = None, trial: int | None = None) -> float:
        """Root mean square error [rad] over all, or of one channel or trial."""
        rows = np.ones(len(self.trial), bool) if trial is None else self.trial == trial
        pick = slice(None) if channel is None else [channel]
        count = self.count[rows][:, pick].sum()
        return float(np.sqrt(self.squared[rows][:, pick].sum() / count)) if count else float("nan")

    def interval(self, channel: int | None, rng: np.random.Generator, level: float = 0.95, draws: int = 2000):
        """Bootstrap interval of the RMSE over trials (over folds where there are too few trials)."""
        group = self.trial if len(np.unique(self.trial[self.fold >= 0])) >= 3 else self.fold
        names = np.unique(group[self.fold >= 0])
        pick = slice(None) if channel is None else [channel]
        squared = np.array([self.squared[group == g][:, pick].sum() for g in names])
        count = np.array([self.count[group == g][:, pick].sum() for g in names])
        index = rng.integers(0, len(names), (draws, len(names)))
        rms = np.sqrt(squared[index].sum(1) / np.maximum(count[index].sum(1), 1))
        return [float(x) for x in np.quantile(rms, [0.5 - level / 2, 0.5 + level / 2])]


def confirms(with_effect: CrossValidation, without: CrossValidation, criteria: Criteria) -> bool:
    """Whether left-out trials are simulated better with an effect: on the whole, and at least half of them."""
    squared = [h.squared.sum(1) for h in (with_effect, without)]
    trials = np.unique(without.trial[without.fold >= 0])
    better = [squared[0][without.trial == t].sum() < squared[1][without.trial == t].sum() for t in trials]
    return bool(with_effect.rmse() < criteria.least_gain * without.rmse() and 2 * sum(better) >= len(better))


def cross_validate(problem: Problem, model: Fit, view: ScoreTable, *, most_folds: int = 6) -> CrossValidation:
    """Simulate every trial by a model fitted to the others."""
    windows = problem.windows
    trial = np.asarray(windows.trial)
    fold = folds(trial, windows.real.astype(float))
    fold = np.where(fold >= 0, fold % most_folds, -1)
    c = model.candidate
    parts = model.parts.no_more_than(problem.torque_scale)
    factor = variance.whitener(view.lin, parts, view.response.kernels)
    start = refit_more(problem, c, factor, iterations=0)
    measured = np.asarray(windows.measured)
    weight = np.asarray(windows.weight)

    def without(f: int) -> np.ndarray:
        part = refit_more(problem, start, factor, keep=(fold >= 0) & (fold != f))
        result = initial_states(problem, c.active, part.theta, part.eff, part.refit.point.x0)
        error = result.residual / np.where(weight > 0, weight, 1.0)
        return np.where(weight > 0, measured - error, np.nan)

    simulated = np.full_like(measured, np.nan)
    left_out = np.unique(fold[fold >= 0])
    for f, by_others in zip(left_out, parallel_map(without, left_out), strict=True):
        simulated[fold == f] = by_others[fold == f]
    gap = np.where(np.isnan(simulated), 0.0, measured - simulated)
    return CrossValidation(simulated, (gap**2).sum(1), (~np.isnan(simulated)).sum(1), trial, fold)
