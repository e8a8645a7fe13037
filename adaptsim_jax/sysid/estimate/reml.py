"""Variance components by restricted maximum likelihood (Patterson & Thompson 1971), with the average-information matrix.

The average of observed and expected information (Gilmour, Thompson & Cullis 1995) needs products with vectors alone, and makes
Newton steps of what gradients alone would creep along: three correlation times of one force are nearly alike.
"""

from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from scipy.linalg import get_lapack_funcs

(_potri,) = get_lapack_funcs(("potri",), dtype=np.float64)
TOLERANCE = 3e-3  # of log-likelihood
EVALUATIONS = 40
MOST_SHRINK, MOST_GROW = 4.0, 8.0  # in log, per step
PRIOR = 0.7  # standard deviation of a sensor's log variance: a factor of two about what was declared or estimated


@dataclass(frozen=True)
class Terms:
    """`cov(residual[w]) = sum_c s_c diag(sensor[c, w]) + sum_k a_k force[k, w]`, initial states projected out.

    residual `[W, M]`; jac_state `[W, M, S]`; sensor `[Y, W, M]`; force `[K, W, M, M]`; used `[W, M]`, False for padding.
    """

    residual: np.ndarray
    jac_state: np.ndarray
    sensor: np.ndarray
    force: np.ndarray
    used: np.ndarray


@dataclass(frozen=True)
class Point:
    """Where a search stands: log components `[C]`, negative log-likelihood with its gradient and average information in them,
    and `drift`, the step that each component would take alone by its own quadratic form against its expectation."""

    log: np.ndarray
    value: float
    slope: np.ndarray
    information: np.ndarray
    drift: np.ndarray


def maximised(terms: Terms, first: np.ndarray, low: np.ndarray, high: np.ndarray) -> Point:
    """The highest restricted likelihood within bounds that log components `[C]`, sensors first, lead to from `first`.

    Raises `LinAlgError` where already the covariance at `first` has no factor.
    """
    at, damping = _evaluated(terms, np.clip(first, low, high)), 1e-3
    for _ in range(EVALUATIONS):
        new = _stepped(at, damping, low, high)
        promised = -(at.slope @ np.expm1(new - at.log))
        if 0 <= promised < TOLERANCE or damping > 1e5:
            break
        gain = -np.inf
        if promised > 0:  # cut to their limits, steps of components that are alike may lead uphill together
            with suppress(np.linalg.LinAlgError):  # too far: forces beyond what rounding lets be factored
                tried = _evaluated(terms, new)
                gain = at.value - tried.value
        if gain > 0:
            at, damping = tried, max(damping / 10.0, 1e-6)
        else:
            damping = max(damping * 10.0, 1e-2)
        if 0 < gain < TOLERANCE:
            break
    return at


def _stepped(at: Point, damping: float, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """A damped Newton step in the components themselves, taken in their logarithms: none becomes negative."""
    held = ((at.log <= low) & (at.slope > 0)) | ((at.log >= high) & (at.slope < 0))
    free = np.flatnonzero(~held)
    if not len(free):
        return at.log
    curve = (at.information + np.diag(np.maximum(at.slope, 0.0)))[np.ix_(free, free)]
    curve += np.diag(damping * np.diag(curve) + 1e-12 * np.trace(curve))
    change = np.zeros_like(at.log)
    change[free] = -np.linalg.solve(curve, at.slope[free])
    step = np.maximum(np.log1p(np.maximum(change, -1.0 + 1e-9)), -MOST_SHRINK)
    # far below its size a component's information says little; its own form then says how far up it is
    drift = np.minimum(at.drift, MOST_GROW) / (1.0 + 100.0 * damping)
    step = np.where(change > 0, np.maximum(step, drift), step)
    return np.clip(at.log + step, low, high)


def _evaluated(terms: Terms, log: np.ndarray) -> Point:
    size, sensors = np.exp(log), len(terms.sensor)
    inverse, logdet = _inverted(terms, size)
    seen = inverse @ terms.jac_state
    info = np.swapaxes(terms.jac_state, 1, 2) @ seen
    corner = np.arange(info.shape[1])
    info[:, corner, corner] *= 1.0 + 1e-9  # a short window may not fix all of its initial state
    info[:, corner, corner] += 1e-9
    back = np.linalg.solve(info, np.swapaxes(seen, 1, 2))  # [W, S, M]
    first = (inverse @ terms.residual[..., None])[..., 0]
    weighted = first - (np.swapaxes(back, 1, 2) @ (np.swapaxes(seen, 1, 2) @ terms.residual[..., None]))[..., 0]

    # traces of each part with the projected inverse, and quadratic forms: through products with S + 1 vectors
    onto = terms.force @ np.concatenate([weighted[..., None], seen], -1)  # [K, W, M, 1 + S]
    count = len(terms.force)
    trace_force = terms.force.reshape(count, -1) @ inverse.ravel()
    trace_force -= (onto[..., 1:] * np.swapaxes(back, 1, 2)).sum((1, 2, 3))
    diagonal = np.diagonal(inverse, axis1=1, axis2=2) - (np.swapaxes(seen, 1, 2) * back).sum(1)
    trace = np.concatenate([np.tensordot(terms.sensor, diagonal, 2), trace_force])
    moved = np.concatenate([terms.sensor * weighted, onto[..., 0]])  # [C, W, M]
    form = (moved * weighted).sum((1, 2))

    m = np.moveaxis(moved * size[:, None, None], 0, -1)  # [W, M, C]
    projected = inverse @ m - seen @ (back @ m)
    information = 0.5 * np.tensordot(m, projected, ((0, 1), (0, 1)))
    slope = 0.5 * size * (trace - form)
    slope[:sensors] += log[:sensors] / PRIOR**2
    information[np.arange(sensors), np.arange(sensors)] += 1.0 / PRIOR**2
    value = logdet + np.linalg.slogdet(info)[1].sum() + np.sum(terms.residual * weighted)
    drift = 0.5 * np.log(np.maximum(form, 1e-300) / np.maximum(trace, 1e-300))
    return Point(log, 0.5 * value + 0.5 * np.sum((log[:sensors] / PRIOR) ** 2), slope, information, drift)


def _inverted(terms: Terms, size: np.ndarray) -> tuple[np.ndarray, float]:
    """Inverse covariances `[W, M, M]` and the sum of their log determinants."""
    sensors, (windows, rows) = len(terms.sensor), terms.residual.shape
    cov = (size[sensors:] @ terms.force.reshape(len(terms.force), -1)).reshape(windows, rows, rows)
    index = np.arange(rows)
    cov[:, index, index] += np.tensordot(size[:sensors], terms.sensor, 1) + ~terms.used
    lower = factored(cov)
    logdet = 2.0 * np.log(np.diagonal(lower, axis1=1, axis2=2)).sum()
    for matrix in lower:  # in place, and half the work of a general inverse
        _potri(matrix.T, lower=0, overwrite_c=1)
    inverse = lower + np.swapaxes(lower, 1, 2)  # above the diagonal there are zeros
    inverse[:, index, index] *= 0.5
    return inverse, logdet


def factored(cov: np.ndarray) -> np.ndarray:
    """Cholesky factors `[W, M, M]`. Forces a million times the sensors leave a covariance that rounding has made indefinite: a
    trace of white noise mends it."""
    for share in (0.0, 1e-12, 1e-10):
        with suppress(np.linalg.LinAlgError):
            trace = np.trace(cov, axis1=1, axis2=2)[:, None, None]
            return np.linalg.cholesky(cov + share * trace * np.eye(cov.shape[1]) if share else cov)
    raise np.linalg.LinAlgError("a residual covariance has no factor; the model's response to forces is not finite")
