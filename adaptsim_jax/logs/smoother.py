"""Angle and speed of a motion by an integrated random walk, where fits of masses begin.

The signal's m-th derivative is white noise of intensity `s^2` (m = 3: white jerk, the quintic
smoothing spline; Wahba 1978, and Sarkka 2013, ch. 8 for the same posterior by filtering). States
are the signal and its first m - 1 derivatives, scaled by powers of the median step: uneven sampling
is exact, the precision matrix is block tridiagonal, and the cost is O(T).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded
from scipy.optimize import minimize_scalar

from adaptsim_jax.logs.criteria import SMOOTHER

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
class NoiseFit:
    """`std`: noise std; `log_ratio`: log of the walk's variance per median step over the noise
    variance.
    """

    std: float
    log_ratio: float


def make_prior(time: np.ndarray, order: int, intensity: np.ndarray | None = None) -> Prior:
    """Precision of the `order`-times integrated random walk on `time: [T]` s (any spacing,
    increasing).

    Args:
        intensity: `[T - 1]`, scales the walk's variance step by step, for signals that are rough
            in places only.
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
    bound = sum(float(np.sum(w * (y - mean[:, k]) ** 2)) for k, w, y in parts)
    return mean, factor, max(quad, bound, 1e-300)


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


def fit_noise(time: np.ndarray, y: np.ndarray, order: int) -> NoiseFit:
    """Maximum-likelihood noise std and log signal-to-noise ratio of one signal `y: [T]`."""
    prior = make_prior(time, order)
    centred = detrend(time, y, order)
    scale = float(np.std(centred))
    if scale <= 1e-12 * float(np.max(np.abs(y)) + 1e-300):
        return NoiseFit(0.0, LOG_RATIO[0])
    weights = [np.ones(len(y))] + [None] * (order - 1)
    data = [centred / scale] + [None] * (order - 1)

    def objective(log_ratio: float) -> float:
        return cost(prior, log_ratio, weights, data, len(y))[0]

    best = minimise(objective, LOG_RATIO, 0.1)
    variance = cost(prior, best, weights, data, len(y))[1]
    return NoiseFit(scale * math.sqrt(variance), best)


def estimate(time: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Noise std of one signal `y: [T]` at `time: [T]` s, and the share of its windows that hide the
    noise.
    """
    windows = np.array_split(np.arange(len(y)), max(1, len(y) // SMOOTHER.window))
    fits = [fit_window(time[w], y[w]) for w in windows]
    # A window at rest in a quantised channel shows no noise at all: it says nothing about the
    # moving sensor.
    informative = [f for f in fits if f[0] > 0] or fits
    return float(np.median([std for std, _ in informative])), float(
        np.mean([hidden for _, hidden in informative])
    )


def fit_window(time: np.ndarray, y: np.ndarray) -> tuple[float, bool]:
    """Noise std of a short signal, and whether the motion hides it (then a guess between two
    priors).
    """
    jerk = fit_noise(time, y, 3)
    if jerk.log_ratio < SMOOTHER.coarse or jerk.std == 0:
        return jerk.std, False
    snap = fit_noise(time, y, 4)
    if snap.std > SMOOTHER.different * jerk.std:
        return float(np.sqrt(snap.std * jerk.std)), True
    return (snap.std if jerk.log_ratio > SMOOTHER.rough else jerk.std), False


def smoothed(
    time: np.ndarray, q: np.ndarray, v: np.ndarray | None, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Positions and speeds `[T, n]`: posterior mean of the motion of each joint.

    Args:
        time: [T] s.
        q: [T, n] rad. v: [T, n] rad/s, or None. It counts where it agrees with the angles.
        noise: [2, n], standard deviations of both. That of speeds is 0 where none were measured.

    Returns:
        Positions in rad and speeds in rad/s.
    """
    joints = []
    for j, (sq, sv) in enumerate(np.maximum(noise, [[1e-9], [0.0]]).T):
        own = None if v is None or sv <= 0 else v[:, j]
        joints.append(_smooth_joint(time, q[:, j], own, float(sq), float(sv)))
    states = np.stack(joints, axis=-1)
    return states[:, 0], states[:, 1]


def _smooth_joint(
    time: np.ndarray, q: np.ndarray, v: np.ndarray | None, sq: float, sv: float
) -> np.ndarray:
    """Angle and speed `[T, 2]`. Speeds are dropped where they make the angles fit worse than their
    noise allows (a lagging filter, a wrong scale).
    """
    order, levels = _intensity(time, q, sq)
    prior = make_prior(time, order, levels)
    alone = _states(prior, q, sq, None, 0.0)
    if v is None:
        return alone
    both = _states(prior, q, sq, v, sv)
    usual = max(sq**2, float(np.mean((q - alone[:, 0]) ** 2)))
    if np.mean((q - both[:, 0]) ** 2) > SMOOTHER.speeds_off * usual:
        return alone
    return both


def _intensity(time: np.ndarray, q: np.ndarray, std: float) -> tuple[int, np.ndarray]:
    """Order of the walk and its intensity `[T - 1]` over the noise, by maximum likelihood per
    window.
    """
    windows = np.array_split(np.arange(len(q)), max(1, len(q) // SMOOTHER.window))
    logs = np.array([_level(time[w], q[w], std, 3) for w in windows])
    order = 4 if np.median(logs) > SMOOTHER.rough else 3
    if order == 4:
        logs = np.array([_level(time[w], q[w], std, 4) for w in windows])
    # Windows of another median step are brought to the step of the whole trial.
    step = np.median(np.diff(time))
    logs -= (2 * order - 1) * np.log([np.median(np.diff(time[w])) / step for w in windows])
    centres = [time[w].mean() for w in windows]
    middles = 0.5 * (time[1:] + time[:-1])
    return order, np.exp(np.interp(middles, centres, logs))


def _level(time: np.ndarray, q: np.ndarray, std: float, order: int) -> float:
    """Log intensity of the walk of one window, the noise std being known."""
    prior = make_prior(time, order)
    weights = [np.ones(len(q))] + [None] * (order - 1)
    data = [detrend(time, q, order) / std] + [None] * (order - 1)

    def objective(log_ratio: float) -> float:
        _, factor, quad = posterior(prior, float(np.exp(log_ratio)), weights, data)
        return quad + order * (prior.size - 1) * log_ratio + 2.0 * float(np.sum(np.log(factor[0])))

    return minimise(objective, (-18.0, 14.0), 0.2)


def _states(prior: Prior, q: np.ndarray, sq: float, v: np.ndarray | None, sv: float) -> np.ndarray:
    """Posterior mean of angle and velocity `[T, 2]` in SI units."""
    h, m = prior.step, prior.order
    offset = q.mean()
    weights: list = [np.ones(len(q))] + [None] * (m - 1)
    data: list = [(q - offset) / sq] + [None] * (m - 1)
    if v is not None:
        weights[1] = np.full(len(q), (sq / (sv * h)) ** 2)
        data[1] = v * h / sq
    mean = posterior(prior, 1.0, weights, data)[0][:, :2]
    return mean * sq / h ** np.arange(2) + np.array([offset, 0.0])
