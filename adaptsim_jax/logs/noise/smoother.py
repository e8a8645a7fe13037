"""Smoothing of a signal by an integrated random walk: exact likelihood and mean from one banded
Cholesky.

The signal's m-th derivative is white noise of intensity `s^2` (m = 3: white jerk, the quintic
smoothing spline; Wahba 1978, and Sarkka 2013, ch. 8 for the same posterior by filtering). States
are the signal and its first m - 1 derivatives at the sampling times, scaled by powers of the median
step: uneven sampling is exact and the precision matrix is block tridiagonal: cost O(T), no loop
over time.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded
from scipy.optimize import minimize_scalar

LOG_RATIO = (-22.0, 10.0)
"""Natural-log range searched for the signal-to-noise ratio of one step; beyond it nothing changes.
"""


@dataclass(frozen=True)
class Prior:
    """The random walk on one time grid; `bands: [2m, m T]`: its precision at unit intensity, lower
    banded.
    """

    order: int
    step: float
    bands: np.ndarray
    size: int


@dataclass(frozen=True)
class Fit:
    """`std`: noise std; `log_ratio`: log of the walk's variance per median step over the noise
    variance.
    """

    std: float
    log_ratio: float


def make_prior(time: np.ndarray, order: int, intensity: np.ndarray | None = None) -> Prior:
    """Precision of the `order`-times integrated random walk on `time: [T]` s (any spacing,
    increasing).

    `intensity: [T - 1]` scales the walk's variance step by step, for signals that are rough in
    places only.
    """
    dt = np.diff(time)
    step = float(np.median(dt))
    r = dt / step
    i, j = np.meshgrid(np.arange(order), np.arange(order), indexing="ij")
    fact = np.array([math.factorial(k) for k in range(2 * order)], dtype=float)
    power = np.where(j >= i, j - i, 0)
    transition = np.where(j >= i, r[:, None, None] ** power / fact[power], 0.0)
    n = 2 * order - 1 - i - j
    a, b = order - 1 - i, order - 1 - j
    noise = r[:, None, None] ** n / (n * fact[a] * fact[b])
    info = np.linalg.inv(noise)
    if intensity is not None:
        info = info / intensity[:, None, None]
    cross = -info @ transition
    head = np.swapaxes(transition, 1, 2) @ info @ transition
    return Prior(order, step, _banded(head, info, cross), len(time))


def _banded(head: np.ndarray, tail: np.ndarray, cross: np.ndarray) -> np.ndarray:
    """Lower banded storage `[2m, m T]` of the block tridiagonal matrix of `[T - 1, m, m]`
    blocks.
    """
    n, m = head.shape[0] + 1, head.shape[1]
    diagonal = np.zeros((n, m, m))
    diagonal[:-1] += head
    diagonal[1:] += tail
    bands = np.zeros((2 * m, n, m))
    for col in range(m):
        for row in range(col, m):
            bands[row - col, :, col] = diagonal[:, row, col]
        for row in range(m):
            bands[m + row - col, :-1, col] = cross[:, row, col]
    return bands.reshape(2 * m, n * m)


def posterior(
    prior: Prior, ratio: float, weights: list[np.ndarray | None], data: list[np.ndarray | None]
):
    """Posterior mean `[T, m]` (scaled states), Cholesky factor and quadratic form for given noise
    weights.

    `data[k]: [T]` measures the scaled k-th derivative with precision `weights[k]: [T]` (None: not
    measured).
    """
    m, n = prior.order, prior.size
    bands = prior.bands / ratio
    rhs = np.zeros((n, m))
    for k, (w, y) in enumerate(zip(weights, data, strict=True)):
        if w is not None and y is not None:
            bands[0, k::m] += w
            rhs[:, k] = w * y
    factor = _factor(bands)
    mean = cho_solve_banded((factor, True), rhs.reshape(-1), check_finite=False).reshape(n, m)
    parts = [(k, w, y) for k, (w, y) in enumerate(zip(weights, data, strict=True)) if w is not None]
    quad = sum(float(np.sum(w * y * (y - mean[:, k]))) for k, w, y in parts)
    # The quadratic form exceeds the residual's part of it; rounding may not.
    least = sum(float(np.sum(w * (y - mean[:, k]) ** 2)) for k, w, y in parts)
    return mean, factor, max(quad, least, 1e-300)


def _factor(bands: np.ndarray) -> np.ndarray:
    """Banded Cholesky factor, the diagonal raised a little where very uneven times make rounding
    matter.
    """
    for ridge in (0.0, 1e-12, 1e-9, 1e-6, 1e-3):
        try:
            raised = np.concatenate([bands[:1] * (1.0 + ridge), bands[1:]])
            return cholesky_banded(raised, lower=True, overwrite_ab=True, check_finite=False)
        except LinAlgError:
            continue
    raise LinAlgError("the sampling times are too uneven to smooth over")


def cost(
    prior: Prior, log_ratio: float, weights: list, data: list, count: int
) -> tuple[float, float]:
    """-2 log likelihood with the noise scale profiled out, and that scale's variance; diffuse first
    state.
    """
    ratio = math.exp(log_ratio)
    _, factor, quad = posterior(prior, ratio, weights, data)
    logdet = 2.0 * float(np.sum(np.log(factor[0])))
    dof = max(count - prior.order, 1)
    variance = quad / dof
    return dof * math.log(variance) + prior.order * (prior.size - 1) * log_ratio + logdet, variance


def minimise(
    function: Callable[[float], float], bounds: tuple[float, float], tolerance: float
) -> float:
    """Where a function of one number is least within `bounds` (Brent)."""
    found: Any = minimize_scalar(
        function, bounds=bounds, method="bounded", options={"xatol": tolerance}
    )
    return float(found.x)


def detrend(time: np.ndarray, y: np.ndarray, order: int) -> np.ndarray:
    """`y` less its polynomial of degree `order - 1`, which the walk gives free: only rounding
    changes.
    """
    s = (time - time[0]) / (time[-1] - time[0]) * 2.0 - 1.0
    basis = np.polynomial.legendre.legvander(s, order - 1)
    return y - basis @ np.linalg.lstsq(basis, y, rcond=None)[0]


def fit_noise(time: np.ndarray, y: np.ndarray, order: int) -> Fit:
    """Maximum-likelihood noise std and log signal-to-noise ratio of one signal `y: [T]`."""
    prior = make_prior(time, order)
    centred = detrend(time, y, order)
    scale = float(np.std(centred))
    if scale <= 1e-12 * float(np.max(np.abs(y)) + 1e-300):
        return Fit(0.0, LOG_RATIO[0])
    weights = [np.ones(len(y))] + [None] * (order - 1)
    data = [centred / scale] + [None] * (order - 1)

    def objective(log_ratio: float) -> float:
        return cost(prior, log_ratio, weights, data, len(y))[0]

    best = minimise(objective, LOG_RATIO, 0.1)
    variance = cost(prior, best, weights, data, len(y))[1]
    return Fit(scale * math.sqrt(variance), best)
