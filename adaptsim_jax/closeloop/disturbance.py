"""What is random in a recording: sensor noise, and torques that no model of the mechanism explains.

A stretch of data simulated from its own initial state misses the measurement for two random reasons: the sensor, and a
force that wanders (a cable, an amplifier, air). The second makes neighbouring residuals alike, so a test that counts
samples as facts finds effects where none are. Here both are variance components of a Gaussian residual,

    cov(residual of window w) = sum_c s_c I_c + sum_{j,tau} a_{j,tau} H_wj T_tau H_wj',

H the response of the outputs to a force on joint j, T the covariance of an Ornstein-Uhlenbeck force with correlation
time tau. The components are estimated by restricted maximum likelihood (Patterson & Thompson 1971), initial states
projected out; whitening with the result makes residuals nearly independent, with unit variance.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import minimize

CORRELATION_TIMES = (0.02, 0.1, 0.5)  # s: faster than a row, a motion's phase, slower than a window


@dataclass(frozen=True)
class Linearised:
    """A model linearised about a fitted trajectory, row by row of each window, rows flattened to M.

    residual: `[W, M]` measured minus simulated, in sensor standard deviations; jac_state: `[W, M, S]`;
    jac_theta: `[W, M, P]`; atoms: `[W, M, K]` output change per unit amplitude of each candidate column;
    impulse: `[W, M, n, L]` response to a unit force on joint j held over row l; dt: `[W, L]` s;
    channel: `[M]` output index of each row; trial: `[W]`; used: `[W, M]` False for padding.
    """

    residual: np.ndarray
    jac_state: np.ndarray
    jac_theta: np.ndarray
    atoms: np.ndarray
    impulse: np.ndarray
    dt: np.ndarray
    channel: np.ndarray
    trial: np.ndarray
    used: np.ndarray


@dataclass(frozen=True)
class Components:
    """Variance components: sensor variance ratio per channel `[Y]`, force variance per joint and correlation time."""

    sensor: np.ndarray  # [Y], 1.0 where the declared standard deviation is right
    force: np.ndarray  # [n, len(CORRELATION_TIMES)] (N m)^2

    def force_std(self) -> np.ndarray:
        """Standard deviation of the unexplained force, per joint `[n]` N m."""
        return np.sqrt(self.force.sum(1))


@dataclass(frozen=True)
class Whitened:
    """Residual covariance made the identity and initial states projected out; rows stay M, of which S are lost.

    jac_state_q: `[W, M, S]` orthonormal basis of what the initial states produce, after whitening.
    """

    residual: np.ndarray  # [W, M]
    jac_theta: np.ndarray  # [W, M, P]
    atoms: np.ndarray  # [W, M, K]
    trial: np.ndarray  # [W]
    rows: np.ndarray  # [W] effective number of rows


def null_basis(jac_state: np.ndarray) -> np.ndarray:
    """Orthonormal basis `[W, M, M-S]` of what no initial state can produce."""
    q, _ = np.linalg.qr(jac_state, mode="complete")
    return q[:, :, jac_state.shape[2] :]


def _force_kernels(lin: Linearised, basis: np.ndarray, windows: np.ndarray) -> np.ndarray:
    """Projected response covariances of unit-variance forces: `[n * taus, W', m, m]`."""
    impulse = np.swapaxes(basis[windows], 1, 2)[:, None] @ np.moveaxis(lin.impulse[windows], 2, 1)  # [W', n, m, L]
    time = np.cumsum(lin.dt[windows], axis=1)
    gap = np.abs(time[:, :, None] - time[:, None, :])
    kernels = []
    for joint in range(impulse.shape[1]):
        for tau in CORRELATION_TIMES:
            h = impulse[:, joint]
            kernels.append(h @ np.exp(-gap / tau) @ np.swapaxes(h, 1, 2))
    return np.stack(kernels)


def _sensor_kernels(lin: Linearised, basis: np.ndarray, windows: np.ndarray) -> np.ndarray:
    b = basis[windows]
    return np.stack(
        [
            np.einsum("wmi,wm,wmj->wij", b, lin.used[windows] * (lin.channel == c)[None], b)
            for c in np.unique(lin.channel)
        ]
    )


def _covariance(lin: Linearised, basis: np.ndarray, windows: np.ndarray, parts: Components) -> np.ndarray:
    sensor, force = _sensor_kernels(lin, basis, windows), _force_kernels(lin, basis, windows)
    return (
        np.tensordot(parts.sensor, sensor, 1)
        + np.tensordot(parts.force.ravel(), force, 1)
        + _padding(lin, basis, windows)
    )


def _padding(lin: Linearised, basis: np.ndarray, windows: np.ndarray) -> np.ndarray:
    """Unit variance for rows that are not there: they carry zero residual and add nothing to any likelihood."""
    b = basis[windows]
    return np.einsum("wmi,wm,wmj->wij", b, ~lin.used[windows], b)


def _spread(windows: np.ndarray, most: int) -> np.ndarray:
    """At most `most` of the windows, evenly spread over the recording."""
    if len(windows) <= most:
        return windows
    return windows[np.linspace(0, len(windows) - 1, most).round().astype(int)]


def estimate(lin: Linearised, *, most_windows: int = 32, start: Components | None = None) -> Components:
    """Restricted maximum likelihood of the variance components from the residuals `[W, M]`."""
    full = np.flatnonzero(lin.used.any(1))
    windows = _spread(full, most_windows)
    basis = null_basis(lin.jac_state)
    kernels = np.concatenate([_sensor_kernels(lin, basis, windows), _force_kernels(lin, basis, windows)])
    pad = _padding(lin, basis, windows)
    resid = np.einsum("wmi,wm->wi", basis[windows], lin.residual[windows])
    n_sensor = len(np.unique(lin.channel))
    scale = np.concatenate(
        [
            np.ones(n_sensor),
            [max(k.trace(axis1=1, axis2=2).mean() / k.shape[1], 1e-30) for k in kernels[n_sensor:]],
        ]
    )
    scaled = kernels / scale[:, None, None, None]

    def objective(log_a: np.ndarray) -> tuple[float, np.ndarray]:
        a = np.exp(log_a)
        cov = np.tensordot(a, scaled, 1) + pad
        inverse = np.linalg.inv(cov)
        logdet = np.linalg.slogdet(cov)[1].sum()
        weighted = np.einsum("wij,wj->wi", inverse, resid)
        traces = np.einsum("qwij,wji->q", scaled, inverse, optimize=True)
        quads = np.einsum("wi,qwij,wj->q", weighted, scaled, weighted, optimize=True)
        # a weak prior keeps each sensor's variance within a factor of about two of what was declared or estimated
        prior = 0.5 * np.sum((log_a[:n_sensor] / 0.7) ** 2)
        slope = 0.5 * a * (traces - quads)
        slope[:n_sensor] += log_a[:n_sensor] / 0.49
        return 0.5 * (logdet + np.sum(resid * weighted)) + prior, slope

    first = np.log(np.full(len(scale), 1e-2))
    first[:n_sensor] = 0.0
    if start is not None:
        first = np.log(np.clip(np.concatenate([start.sensor, start.force.ravel() * scale[n_sensor:]]), 1e-7, 1e12))
    bounds = [(np.log(0.05), np.log(50.0))] * n_sensor + [(np.log(1e-8), np.log(1e12))] * (len(scale) - n_sensor)
    found = minimize(
        objective, first, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 40, "ftol": 1e-9}
    )
    a = np.exp(found.x) / scale
    return Components(a[:n_sensor], a[n_sensor:].reshape(lin.impulse.shape[2], len(CORRELATION_TIMES)))


def whitener(lin: Linearised, parts: Components) -> np.ndarray:
    """Inverse Cholesky factor `[W, M, M]` of each window's residual covariance."""
    eye = np.broadcast_to(np.eye(lin.residual.shape[1]), (len(lin.residual), *[lin.residual.shape[1]] * 2))
    lower = np.linalg.cholesky(_covariance(lin, eye, np.arange(len(lin.residual)), parts))
    return solve_triangular(lower, eye, lower=True)


def whiten(lin: Linearised, factor: np.ndarray) -> Whitened:
    """Decorrelate with `factor` (from `whitener`, possibly of another linearisation) and project initial states out."""
    q, _ = np.linalg.qr(factor @ lin.jac_state)

    def clean(z: np.ndarray) -> np.ndarray:
        z = factor @ z
        return z - q @ (np.swapaxes(q, 1, 2) @ z)

    rows = np.maximum(lin.used.sum(1) - lin.jac_state.shape[2], 0)
    return Whitened(clean(lin.residual[..., None])[..., 0], clean(lin.jac_theta), clean(lin.atoms), lin.trial, rows)


def unexplained_force(lin: Linearised, parts: Components) -> tuple[np.ndarray, np.ndarray]:
    """The force that the residual points to: posterior mean and standard deviation `[W, n, L]` N m.

    The Wiener estimate under the components: prior covariance times impulse response times inverse covariance.
    """
    basis = null_basis(lin.jac_state)
    every = np.arange(len(lin.residual))
    inverse = np.linalg.inv(_covariance(lin, basis, every, parts))
    resid = np.einsum("wmi,wm->wi", basis, lin.residual)
    time = np.cumsum(lin.dt, axis=1)
    gap = np.abs(time[:, :, None] - time[:, None, :])
    mean, std = [], []
    for joint in range(lin.impulse.shape[2]):
        prior = sum(a * np.exp(-gap / tau) for a, tau in zip(parts.force[joint], CORRELATION_TIMES, strict=True))
        cross = prior @ np.swapaxes(lin.impulse[:, :, joint], 1, 2) @ basis  # [W, L, m]
        mean.append(np.einsum("wlm,wmk,wk->wl", cross, inverse, resid, optimize=True))
        explained = np.einsum("wlm,wmk,wlk->wl", cross, inverse, cross, optimize=True)
        std.append(np.sqrt(np.maximum(parts.force[joint].sum() - explained, 0.0)))
    return np.stack(mean, 1), np.stack(std, 1)


def log_likelihood(lin: Linearised, parts: Components) -> np.ndarray:
    """Restricted log-likelihood of each window `[W]`, initial states integrated out; constants left out."""
    basis = null_basis(lin.jac_state)
    cov = _covariance(lin, basis, np.arange(len(lin.residual)), parts)
    resid = np.einsum("wmi,wm->wi", basis, lin.residual)
    lower = np.linalg.cholesky(cov)
    logdet = 2.0 * np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(1)
    white = solve_triangular(lower, resid[..., None], lower=True)[..., 0]
    return -0.5 * (logdet + np.sum(white**2, axis=1))
