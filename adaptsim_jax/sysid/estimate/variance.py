"""What is random in a recording: sensor noise, and torques that no model of the mechanism explains.

A stretch of data simulated from its own initial state misses the measurement for two random reasons: the sensor, and a
force that wanders (a cable, an amplifier, air). The second makes neighbouring residuals alike, so a test that counts
samples as facts finds effects where none are. Here both are variance components of a Gaussian residual,

    cov(residual of window w) = sum_c s_c I_c + sum_{j,tau} a_{j,tau} H_wj T_tau H_wj',

H the response of the outputs to a force on joint j, T the covariance of an Ornstein-Uhlenbeck force with correlation
time tau. The components are estimated by restricted maximum likelihood (Patterson & Thompson 1971), initial states
projected out; whitening with the result makes residuals nearly independent, with unit variance.
"""

from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular

from adaptsim_jax.core.parallel import parallel_map
from adaptsim_jax.sysid.estimate.reml import Terms, factored, maximised

COLUMNS = 256  # of atoms that are whitened at a time: what lies between stays small
INFLATED = 2.0  # times a sensor's variance: beyond this the components are looked for from large forces, too
FAR_ABOVE = 100.0  # times that: the forces to start from, which shrink more easily than they grow
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
class VarianceComponents:
    """Variance components: sensor variance ratio per channel `[Y]`, force variance per joint and correlation time."""

    sensor: np.ndarray  # [Y], 1.0 where the declared standard deviation is right
    force: np.ndarray  # [n, len(CORRELATION_TIMES)] (N m)^2

    def force_std(self) -> np.ndarray:
        """Standard deviation of the unexplained force, per joint `[n]` N m."""
        return np.sqrt(self.force.sum(1))

    def no_more_than(self, torque: np.ndarray) -> "VarianceComponents":
        """The same, or the sensors alone where the force is beyond `torque [n]` N m: that is no disturbance, and a fit that
        takes it for one trusts nothing."""
        wild = np.any(self.force_std() > torque)
        return VarianceComponents(self.sensor, np.zeros_like(self.force)) if wild else self


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


@dataclass(frozen=True)
class Kernels:
    """Response covariances of unit-variance forces, joint by joint and correlation time by correlation time.

    force: `[n * taus, W, M, M]`. They follow from the impulse responses alone, which hardly move between rival models of
    one recording: computed once, they serve all of them.
    """

    force: np.ndarray

    @cached_property
    def weight(self) -> np.ndarray:
        """How far a unit-variance force of each joint and correlation time moves the outputs, `[n, taus]`, as a share of what
        the most effective time does: a force that changes its mind fifty times a second moves nothing far."""
        moved = np.trace(self.force, axis1=2, axis2=3).mean(1).reshape(-1, len(CORRELATION_TIMES))
        return moved / np.maximum(moved.max(1, keepdims=True), 1e-300)

    def covariance(
        self, lin: Linearised, parts: "VarianceComponents", windows: np.ndarray | slice = slice(None)
    ) -> np.ndarray:
        """Residual covariance `[W', M, M]`. Rows that are not there get unit variance: they add nothing to any likelihood."""
        cov = np.tensordot(parts.force.ravel(), self.force[:, windows], 1)
        diagonal = np.where(lin.used[windows], parts.sensor[lin.channel][None], 1.0)
        index = np.arange(cov.shape[1])
        cov[:, index, index] += diagonal
        return cov


def force_kernels(lin: Linearised) -> Kernels:
    """Kernels of one linearisation, from its impulse responses."""
    time = np.cumsum(lin.dt, axis=1)
    gap = np.abs(time[:, :, None] - time[:, None, :])
    out = []
    for joint in range(lin.impulse.shape[2]):
        h = np.ascontiguousarray(
            lin.impulse[:, :, joint], np.float64
        )  # in float32 a large one is not positive definite
        for tau in CORRELATION_TIMES:
            out.append(h @ np.exp(-gap / tau) @ np.swapaxes(h, 1, 2))
    return Kernels(np.stack(out))


def _spread(windows: np.ndarray, most: int) -> np.ndarray:
    """At most `most` of the windows, evenly spread over the recording."""
    if len(windows) <= most:
        return windows
    return windows[np.linspace(0, len(windows) - 1, most).round().astype(int)]


def estimate(
    lin: Linearised, kernels: Kernels | None = None, *, most_windows: int = 32, start: VarianceComponents | None = None
) -> VarianceComponents:
    """Restricted maximum likelihood of the variance components from the residuals `[W, M]`, by their exact gradient."""
    kernels = kernels or force_kernels(lin)
    at = _spread(np.flatnonzero(lin.used.any(1)), most_windows)
    resid, jac, used = lin.residual[at], lin.jac_state[at], lin.used[at]
    force = kernels.force[:, at]
    n_sensor = len(np.unique(lin.channel))
    trace = np.trace(force, axis1=2, axis2=3).mean(1) / resid.shape[1]
    scale = np.concatenate([np.ones(n_sensor), np.maximum(trace, 1e-30)])
    sensor = np.stack([used * (lin.channel == c) for c in range(n_sensor)]).astype(float)  # [Y, W', M]
    terms = Terms(resid, jac, sensor, force / scale[n_sensor:, None, None, None], used)
    first = np.concatenate([np.ones(n_sensor), np.full(len(force), 1e-2)])
    if start is not None:
        first = np.clip(np.concatenate([start.sensor, start.force.ravel() * scale[n_sensor:]]), 1e-7, 1e12)
    low = np.array([0.05] * n_sensor + [1e-8] * len(force))
    high = np.array([50.0] * n_sensor + [1e12] * len(force))
    likeliest = maximised(terms, np.log(first), np.log(low), np.log(high))
    noisy = np.exp(likeliest.log[:n_sensor]).max()
    if noisy > INFLATED:  # sensors that are said to be worse than they are may hide forces: two optima, far apart
        other = np.concatenate([np.ones(n_sensor), np.full(len(force), FAR_ABOVE * noisy)])
        with suppress(np.linalg.LinAlgError):
            forced = maximised(terms, np.log(other), np.log(low), np.log(high))
            likeliest = min(likeliest, forced, key=lambda point: point.value)
    a = np.exp(likeliest.log) / scale
    return VarianceComponents(a[:n_sensor], a[n_sensor:].reshape(lin.impulse.shape[2], len(CORRELATION_TIMES)))


def whitener(lin: Linearised, parts: VarianceComponents, kernels: Kernels | None = None) -> np.ndarray:
    """Inverse Cholesky factor `[W, M, M]` of each window's residual covariance."""
    lower = factored((kernels or force_kernels(lin)).covariance(lin, parts))
    eye = np.broadcast_to(np.eye(lower.shape[1]), lower.shape)
    return solve_triangular(lower, eye, lower=True)


def whiten(lin: Linearised, factor: np.ndarray) -> Whitened:
    """Decorrelate with `factor` (from `whitener`, possibly of another linearisation) and project initial states out."""
    q, _ = np.linalg.qr(factor @ lin.jac_state)

    def clean(z: np.ndarray) -> np.ndarray:
        out = np.empty((z.shape[2], *z.shape[:2]))  # a column is picked quickly where it lies in one piece

        def part(at: slice) -> None:
            w = factor @ z[..., at]
            out[at] = np.moveaxis(w - q @ (np.swapaxes(q, 1, 2) @ w), -1, 0)

        parallel_map(part, [slice(k, k + COLUMNS) for k in range(0, len(out), COLUMNS)])
        return np.moveaxis(out, 0, -1)

    rows = np.maximum(lin.used.sum(1) - lin.jac_state.shape[2], 0)
    return Whitened(clean(lin.residual[..., None])[..., 0], clean(lin.jac_theta), clean(lin.atoms), lin.trial, rows)


def unexplained_force(lin: Linearised, parts: VarianceComponents) -> tuple[np.ndarray, np.ndarray]:
    """The force that the residual points to: posterior mean and standard deviation `[W, n, L]` N m.

    The Wiener estimate under the components: prior covariance times impulse response times inverse covariance, the
    initial states unknown.
    """
    inverse = np.linalg.inv(force_kernels(lin).covariance(lin, parts))
    seen = inverse @ lin.jac_state
    info = np.swapaxes(lin.jac_state, 1, 2) @ seen
    project = inverse - seen @ np.linalg.pinv(info, rcond=1e-12, hermitian=True) @ np.swapaxes(seen, 1, 2)
    time = np.cumsum(lin.dt, axis=1)
    gap = np.abs(time[:, :, None] - time[:, None, :])
    mean, std = [], []
    for joint in range(lin.impulse.shape[2]):
        prior = sum(a * np.exp(-gap / tau) for a, tau in zip(parts.force[joint], CORRELATION_TIMES, strict=True))
        cross = prior @ np.swapaxes(lin.impulse[:, :, joint], 1, 2)  # [W, L, M]
        gain = cross @ project
        mean.append((gain @ lin.residual[..., None])[..., 0])
        std.append(np.sqrt(np.maximum(parts.force[joint].sum() - np.sum(gain * cross, -1), 0.0)))
    return np.stack(mean, 1), np.stack(std, 1)


def log_likelihood(lin: Linearised, parts: VarianceComponents, kernels: Kernels | None = None) -> np.ndarray:
    """Restricted log-likelihood of each window `[W]`, initial states integrated out; constants left out."""
    lower = factored((kernels or force_kernels(lin)).covariance(lin, parts))
    both = solve_triangular(lower, np.concatenate([lin.jac_state, lin.residual[..., None]], -1), lower=True)
    q, r = np.linalg.qr(both[..., :-1])
    white = both[..., -1:] - q @ (np.swapaxes(q, 1, 2) @ both[..., -1:])
    plain = np.linalg.qr(lin.jac_state, mode="r")
    diagonal = lambda z: 2.0 * np.log(np.abs(np.diagonal(z, axis1=1, axis2=2)) + 1e-300).sum(1)
    logdet = diagonal(lower) + diagonal(r) - diagonal(plain)
    live = lin.used.any(1)
    return np.where(live, -0.5 * (logdet + np.sum(white[..., 0] ** 2, axis=1)), 0.0)
