"""A small Gaussian process with expected improvement, for maximising a noisy function on the unit
box from few values.

Rasmussen and Williams, "Gaussian processes for machine learning" (2006), chapters 2 and 5; Jones et
al., "Efficient global optimization" (1998). Matern 5/2 with a length for each coordinate, double
precision, NumPy and SciPy: tens of values.
"""

from typing import NamedTuple

import numpy as np
from scipy import linalg, optimize, stats

JITTER = 1e-8
LENGTHS, NOISES = (
    (0.05, 4.0),
    (1e-3, 1.0),
)  # bounds, in the box's unit and in standard deviations of the values


class GP(NamedTuple):
    """Fitted to `x [n, D]` and values that were standardised with `mean`, `scale`; `lengths [D]`,
    `noise`: standard deviation.
    """

    x: np.ndarray
    weights: np.ndarray  # inverse(K) y
    chol: np.ndarray
    lengths: np.ndarray
    signal: float
    noise: float
    mean: float
    scale: float


def fit(x: np.ndarray, y: np.ndarray, rng: np.random.Generator, restarts: int = 3) -> GP:
    """Lengths, signal and noise by the largest posterior density from `restarts` starts (log-normal
    priors: few values).
    """
    x, y = np.asarray(x, float), np.asarray(y, float)
    mean, scale = y.mean(), max(y.std(), 1e-6)
    z, D = (y - mean) / scale, x.shape[1]
    bounds = [tuple(np.log(LENGTHS))] * D + [tuple(np.log((0.05, 20.0)))] + [tuple(np.log(NOISES))]
    starts = [np.log([0.5] * D + [1.0, 0.2])]
    starts += [rng.uniform(*np.array(bounds).T) for _ in range(restarts - 1)]
    ends = [
        optimize.minimize(_cost, s, (x, z), jac=True, method="L-BFGS-B", bounds=bounds)
        for s in starts
    ]
    best = np.exp(min(ends, key=lambda end: end.fun).x)
    lengths, signal, noise = best[:D], float(best[D]), float(best[D + 1])
    chol = linalg.cholesky(
        _covariance(x, x, lengths, signal) + (noise**2 + JITTER) * np.eye(len(x)), lower=True
    )
    return GP(x, linalg.cho_solve((chol, True), z), chol, lengths, signal, noise, mean, scale)


def predict(gp: GP, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation `[m]` of the function itself at `x [m, D]`, in the values'
    unit.
    """
    across = _covariance(np.asarray(x, float), gp.x, gp.lengths, gp.signal)
    half = linalg.solve_triangular(gp.chol, across.T, lower=True)
    spread = np.sqrt(np.maximum(gp.signal - (half**2).sum(0), 1e-12))
    return gp.mean + gp.scale * (across @ gp.weights), gp.scale * spread


def expected_improvement(gp: GP, x: np.ndarray, best: float) -> np.ndarray:
    """`[m]`: by how much the function at `x [m, D]` is expected to exceed `best`."""
    mean, spread = predict(gp, x)
    z = (mean - best) / spread
    return (mean - best) * stats.norm.cdf(z) + spread * stats.norm.pdf(z)


def propose(gp: GP, rng: np.random.Generator, candidates: int = 2048) -> np.ndarray:
    """The point `[D]` of the unit box with the largest expected improvement over the best mean at a
    known point.

    Random candidates, half of them around the best known points; the best three are refined.
    """
    D = gp.x.shape[1]
    known = predict(gp, gp.x)[0]
    around = gp.x[np.argsort(-known)[:3]][rng.integers(0, min(3, len(known)), candidates // 2)]
    near = np.clip(around + 0.1 * rng.normal(size=around.shape), 0.0, 1.0)
    tried = np.concatenate([rng.uniform(size=(candidates - len(near), D)), near])

    def value(u):
        return -float(expected_improvement(gp, u[None], known.max())[0])

    first = tried[np.argsort(-expected_improvement(gp, tried, known.max()))[:3]]
    ends = [optimize.minimize(value, u, method="L-BFGS-B", bounds=[(0.0, 1.0)] * D) for u in first]
    return np.clip(min(ends, key=lambda end: end.fun).x, 0.0, 1.0)


def _distances(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.abs(a[:, None] - b[None])


def _covariance(a: np.ndarray, b: np.ndarray, lengths: np.ndarray, signal: float) -> np.ndarray:
    r = np.sqrt(5.0 * ((_distances(a, b) / lengths) ** 2).sum(-1))
    return signal * (1.0 + r + r**2 / 3.0) * np.exp(-r)


def _cost(logs: np.ndarray, x: np.ndarray, z: np.ndarray) -> tuple[float, np.ndarray]:
    """Negative log posterior and its gradient by the logarithms of lengths, signal and noise."""
    D, n = x.shape[1], len(z)
    lengths, signal, noise = np.exp(logs[:D]), np.exp(logs[D]), np.exp(logs[D + 1])
    squares = (_distances(x, x) / lengths) ** 2
    r = np.sqrt(5.0 * squares.sum(-1))
    kernel = signal * (1.0 + r + r**2 / 3.0) * np.exp(-r)
    chol = linalg.cholesky(kernel + (noise**2 + JITTER) * np.eye(n), lower=True)
    inverse = linalg.cho_solve((chol, True), np.eye(n))
    weights = inverse @ z
    inner = 0.5 * (inverse - np.outer(weights, weights))  # derivative of the cost by the covariance
    by_length = (
        5.0 / 3.0 * signal * (1.0 + r) * np.exp(-r)
    )  # times a coordinate's square: dK / d log length
    slopes = [np.sum(inner * by_length * squares[..., i]) for i in range(D)]
    slopes += [np.sum(inner * kernel), 2.0 * noise**2 * np.trace(inner)]
    centre = np.log([0.5] * D + [1.0, 0.2])
    width = np.array([0.75] * D + [1.0, 1.0])
    deviation = (logs - centre) / width
    cost = 0.5 * z @ weights + np.log(np.diag(chol)).sum() + 0.5 * deviation @ deviation
    return float(cost), np.array(slopes) + deviation / width
