"""The ceiling: the held-out error that a flexible model reaches, which names nothing.

The flexible model is the declared one with smooth forces of `generic_forces` at every joint: of angle, speed, command, past and
time, along the motion that was measured. It is linear in its coefficients, so it is fitted by the linear algebra of
`score/scorer.py`, but about the right trajectory: first the force that each window asks for (`variance.unexplained_force`) is
fed to the declared model until that follows the measurements, and only then is everything linearised. Held out as in
`crossval.py`: the declared parameters and the coefficients come from the other folds, initial states from the fold itself,
by least squares.

It is a benchmark, not a bound. A named effect has fewer parameters to learn and may do better, most of all with few trials
or with jumps (dry friction); one that does much worse leaves something that smooth forces can explain.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from adaptsim_jax.sysid.criteria import Criteria
from adaptsim_jax.sysid.estimate import variance
from adaptsim_jax.sysid.estimate.candidate import compressed, linearised, survey
from adaptsim_jax.sysid.estimate.fitted import Fit
from adaptsim_jax.sysid.estimate.generic_forces import generic_forces, generic_names
from adaptsim_jax.sysid.estimate.problem import Problem, at_point
from adaptsim_jax.sysid.estimate.variance import Linearised, VarianceComponents
from adaptsim_jax.sysid.score.table import ScoreTable

ROUNDS = 2  # of feeding the missing force: the second closes what the linearisation of the first left


@dataclass(frozen=True)
class FlexibleBound:
    """Held-out RMSE [rad] of the flexible model, over all channels and of each `[Y]`; groups: what its forces follow."""

    rmse: float
    per_channel: np.ndarray
    groups: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class _Rows:
    """The flexible model's rows about the measured motion: `fine` of every sample, `coarse` averaged for the statistics.
    Atoms are the columns of the forces, residuals what is left with none of them."""

    fine: Linearised
    coarse: Linearised


def flexible_bound(problem: Problem, base: Fit, view: ScoreTable, fold: np.ndarray) -> FlexibleBound | None:
    """Held-out error of the flexible model; `view` is about the declared model `base`, fold `[W]` as in `CrossValidation`.

    None where the declared model runs away when it is driven along the measured motion.
    """
    rows = _rows(problem, base, view)
    if rows is None or not (fold >= 0).any():
        return None
    names = generic_names(problem.plant.joint_dim)
    prior = 1.0 / max(float(base.parts.force.sum()), 1e-12)  # no coefficient beyond what is unexplained in all
    coarse, _, _ = _fitted(rows, base.parts, view, names, prior, fold, problem.criteria)
    left = replace(rows.coarse, residual=np.where(rows.coarse.used, coarse, 0.0))
    # with less unexplained, each window tells more about the coefficients, as it does under a mended model
    parts = variance.estimate(left, view.response.kernels, start=base.parts)
    _, fine, groups = _fitted(rows, parts, view, names, prior, fold, problem.criteria)
    return FlexibleBound(*_rmse(problem, fine, fold), groups)


def _fitted(rows: _Rows, parts: VarianceComponents, view: ScoreTable, names, prior: float, fold, criteria: Criteria):
    """Held-out residuals `[W, M]` of coarse and fine rows under a residual covariance, and the groups picked."""
    factor = variance.whitener(rows.coarse, parts, view.response.kernels)
    groups = _pick(rows.coarse, factor, names, prior, fold, criteria)
    return *_left(rows, factor, _columns(names, groups), prior, fold), groups


def _rows(problem: Problem, base: Fit, view: ScoreTable) -> _Rows | None:
    """The declared model driven along the measured motion, and linearised there."""
    c, lin, windows = base.candidate, view.lin, problem.windows
    force = np.zeros((len(windows.trial), problem.plant.joint_dim, windows.dt.shape[1]))
    x0, fed = c.refit.point.x0, problem
    # with command effects declared, a force and a command differ: then the declared model's own trajectory must do
    for _ in range(0 if _commanded(problem) else ROUNDS):
        factor = variance.whitener(lin, base.parts, view.response.kernels)
        force = force + variance.unexplained_force(lin, base.parts)[0]
        x0 = x0 + _initial(factor, lin, lin.residual)
        torque = np.asarray(windows.torque) + _by_row(problem, force)
        fed = replace(problem, windows=replace(windows, torque=torque))
        result = at_point(fed, c.active, c.theta, c.eff, x0)
        if not np.isfinite(result.residual).all():
            return None
        lin = replace(compressed(fed, linearised(fed, result)), impulse=view.lin.impulse, dt=view.lin.dt)
    _, _, path, result = survey(fed, c.active, c.theta, c.eff, x0, candidates=False)
    forces = generic_forces(replace(path, u=view.path.u))  # of the command as it was recorded
    answer = path.impulse.reshape(*path.impulse.shape[:2], -1)
    fine = linearised(fed, result)
    fine = replace(
        fine, residual=fine.residual + _response(answer, force[None])[..., 0], atoms=_response(answer, forces)
    )
    coarse = replace(compressed(fed, fine), impulse=view.lin.impulse, dt=view.lin.dt)
    return _Rows(fine, coarse)


def _commanded(problem: Problem) -> bool:
    layout = problem.model.layout
    return any(layout.instances[layout.index(*a)].effect.place == "command" for a in problem.base)


def _response(answer: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Output change `[W, M, K]` of forces `[K, W, n, L]`, by the impulse responses `[W, M, n L]`."""
    return np.asarray(answer, float) @ forces.reshape(len(forces), len(answer), -1).transpose(1, 2, 0)


def _by_row(problem: Problem, force: np.ndarray) -> np.ndarray:
    """Window forces `[W, n, L]` as torques held over the trials' rows `[N, T, n]`; every joint is driven."""
    windows = problem.windows
    out = np.zeros_like(np.asarray(windows.torque))
    rows, trial = np.asarray(windows.rows), np.asarray(windows.trial)
    for w, k in zip(*np.nonzero((windows.dt > 0) & windows.real[:, None]), strict=True):
        out[trial[w], rows[w, k] : max(rows[w, k + 1], rows[w, k] + 1)] = force[w, :, k]
    return out


def _initial(factor: np.ndarray | None, lin: Linearised, residual: np.ndarray) -> np.ndarray:
    """Change of the initial states `[W, S]` that fits a residual `[W, M]` best, whitened or (None) by least squares."""
    seen, left = (z if factor is None else factor @ z for z in (lin.jac_state, residual[..., None]))
    normal = np.swapaxes(seen, 1, 2) @ seen
    slope = np.swapaxes(seen, 1, 2) @ left
    return (np.linalg.pinv(normal, rcond=1e-12, hermitian=True) @ slope)[..., 0]


def _columns(names: Sequence[tuple[str, str]], groups: Sequence[tuple[str, str]]) -> list[int]:
    return [i for i, name in enumerate(names) if name in groups]


def _normal(lin: Linearised, factor: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Per window, initial states projected out: `[W, C, C]` and `[W, C]` of `[J_theta | forces]`, and `[W]` squares."""
    white = variance.whiten(lin, factor)
    z = np.concatenate([white.jac_theta, white.atoms], -1)
    zt = np.swapaxes(z, 1, 2)
    return zt @ z, (zt @ white.residual[..., None])[..., 0], np.sum(white.residual**2, axis=1)


def _solve(normal: np.ndarray, slope: np.ndarray, columns: list[int], declared: int, prior: float) -> np.ndarray:
    """Coefficients of the declared parameters and of some columns, the latter held down by the prior."""
    ridge = np.concatenate([np.zeros(declared), np.full(len(columns), prior)])
    pick = [*range(declared), *(declared + k for k in columns)]
    a = normal[np.ix_(pick, pick)] + np.diag(ridge + 1e-9 * np.diag(normal)[pick] + 1e-12)
    out = np.zeros(len(normal))
    out[pick] = np.linalg.solve(a, slope[pick])
    return out


def _pick(
    lin: Linearised, factor: np.ndarray, names, prior: float, fold: np.ndarray, criteria: Criteria
) -> tuple[tuple[str, str], ...]:
    """Groups of columns, one after the other, that lower the held-out sum of squares most."""
    normal, slope, squares = _normal(lin, factor)
    declared = lin.jac_theta.shape[2]
    folds = [(fold >= 0, fold == f) for f in np.unique(fold[fold >= 0])]
    sums = [
        [(normal[w].sum(0), slope[w].sum(0), squares[w].sum()) for w in (real & ~test, test)] for real, test in folds
    ]

    def held_out(groups) -> float:
        total = 0.0
        for (a, b, _), (test_a, test_b, test_c) in sums:
            z = _solve(a, b, _columns(names, groups), declared, prior)
            total += float(test_c - 2 * z @ test_b + z @ test_a @ z)
        return total

    groups, best = (), held_out(())
    for _ in range(criteria.flexible_groups):
        tried = {(*groups, g): held_out((*groups, g)) for g in dict.fromkeys(names) if g not in groups}
        new = min(tried, key=lambda g: tried[g])
        if tried[new] > (1.0 - criteria.follows) * best:
            break
        groups, best = new, tried[new]
    return groups


def _left(rows: _Rows, factor: np.ndarray, columns: list[int], prior: float, fold: np.ndarray):
    """Held-out residuals `[W, M]` of both kinds of rows, in standard deviations."""
    normal, slope, _ = _normal(rows.coarse, factor)
    declared = rows.coarse.jac_theta.shape[2]
    out = [np.zeros_like(lin.residual) for lin in (rows.coarse, rows.fine)]
    for f in np.unique(fold[fold >= 0]):
        train, test = (fold >= 0) & (fold != f), fold == f
        z = _solve(normal[train].sum(0), slope[train].sum(0), columns, declared, prior)
        for lin, left in zip((rows.coarse, rows.fine), out, strict=True):
            left[test] = lin.residual[test] - np.concatenate([lin.jac_theta, lin.atoms], -1)[test] @ z
    start = _initial(factor, rows.coarse, out[0])[..., None]
    return tuple(
        left - (lin.jac_state @ start)[..., 0] for lin, left in zip((rows.coarse, rows.fine), out, strict=True)
    )


def _rmse(problem: Problem, left: np.ndarray, fold: np.ndarray) -> tuple[float, np.ndarray]:
    """Root mean square [rad] over all held-out rows, and of each channel."""
    weight = np.asarray(problem.windows.weight)
    here = (weight > 0) & (fold >= 0)[:, None, None]
    error = np.where(here, left.reshape(weight.shape) / np.where(here, weight, 1.0), 0.0)
    square = np.square(error).sum((0, 1)) / np.maximum(here.sum((0, 1)), 1)
    share = here.sum((0, 1)) / here.sum()
    return float(np.sqrt(square @ share)), np.sqrt(square)
