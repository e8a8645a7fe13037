"""What a fit found: its parameters, residual and derivatives, and how sure it is of them."""

from dataclasses import dataclass

import numpy as np

from adaptsim_jax.sysid.estimate.fit_problem import FitPoint, FitProblem
from adaptsim_jax.sysid.forward import Model

CODES = ("converged", "reached the iteration limit", "no step lowers the cost", "diverged: cost is not finite")


@dataclass(frozen=True)
class FitResult:
    """theta `[P]`, eff `[E]`, x0 `[W, S]`; residual `[W, L+1, Y]` measured minus simulated in standard deviations;
    cost `[W]` half the (robust) sum of squares; jac_shared `[W, (L+1) Y, G]`, jac_state `[W, (L+1) Y, S]` of outputs.

    names: of the fitted parameters `[G]`; covariance `[G, G]` if the weights are right, sandwich `[G, G]` from the
    scatter of clusters (trials if there are at least 6, else windows); condition: of the scaled information; singular:
    directions `[(value, {name: share}), ...]` that the data hardly fix; code: index of CODES.
    """

    theta: np.ndarray
    eff: np.ndarray
    x0: np.ndarray
    mask: np.ndarray
    residual: np.ndarray
    cost: np.ndarray
    jac_shared: np.ndarray
    jac_state: np.ndarray
    names: tuple[str, ...]
    covariance: np.ndarray
    sandwich: np.ndarray
    condition: float
    singular: list[tuple[float, dict[str, float]]]
    iterations: int
    code: int

    @property
    def message(self) -> str:
        return CODES[self.code]

    @property
    def ok(self) -> bool:
        return self.code in (0, 1, 2)


def fit_result(model: Model, problem: FitProblem, point: FitPoint, info) -> FitResult:
    """The solver's last point and its `(schur [W, G, G + 1], iterations, code)`, all of NumPy, as a FitResult."""
    schur, iterations, code = info
    g = len(problem.low)
    live = np.concatenate([np.asarray(problem.free), np.asarray(problem.active) >= 0])
    layout = ["/".join(n) for n in model.layout.names()]
    names = list(model.plant.theta_names) + [layout[a] if a >= 0 else "" for a in np.asarray(problem.active)]
    names = tuple(n for n, on in zip(names, live, strict=True) if on)
    trial = np.asarray(problem.windows.trial)
    schur = schur * np.asarray(problem.trial_weight)[trial][:, None, None]
    hess = schur.sum(0)[:g, :g] + np.diag(np.asarray(problem.prior_precision))
    hess, scores = hess[np.ix_(live, live)], schur[:, :g, g][:, live]
    covariance, sandwich, condition, singular = _uncertainty(hess, scores, trial, names)
    jac = np.moveaxis(point.jac, (3, 0), (0, 3))  # [W, L+1, Y, C-1]
    jac = jac.reshape(len(jac), -1, jac.shape[-1])
    residual = np.moveaxis(point.residual, -1, 0)
    return FitResult(
        point.theta, point.eff, point.x0.T, np.asarray(problem.mask), residual, point.window_cost,
        jac[:, :, :g][:, :, live], jac[:, :, g:], names, covariance, sandwich, condition, singular,
        int(iterations), int(code),
    )  # fmt: skip


@np.errstate(over="ignore", invalid="ignore")  # of a fit that ran away
def _uncertainty(hess, scores, trial, names):
    """Covariances and weak directions, from the reduced information `[G, G]` and the windows' scores `[W, G]`."""
    diagonal = np.diag(hess)
    scale = 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, np.inf))
    value, vector = np.linalg.eigh(hess * scale[:, None] * scale[None, :])
    safe = np.maximum(value, 1e-12)
    inverse = scale[:, None] * (vector / safe) @ vector.T * scale[None, :]
    used = np.unique(trial[np.abs(scores).sum(1) > 0])
    group = trial if len(used) >= 6 else np.arange(len(trial))
    sums = np.stack([scores[group == k].sum(0) for k in np.unique(group)])
    sums = sums[np.abs(sums).sum(1) > 0]
    factor = len(sums) / max(len(sums) - 1, 1)
    sandwich = inverse @ (sums.T @ sums) @ inverse * factor
    weak = [
        (float(v), {n: float(x) for n, x in zip(names, column, strict=True) if abs(x) > 0.2})
        for v, column in zip(value, vector.T, strict=True)
        if v < 1e-4
    ]
    return inverse, sandwich, float(value.max() / max(value.min(), 1e-300)) if len(value) else 1.0, weak
