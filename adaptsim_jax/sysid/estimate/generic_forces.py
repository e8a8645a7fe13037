"""A flexible dictionary of forces: smooth functions of angle, speed, command and time at each joint.

It names nothing. It says how much of a residual any smooth force could explain (the ceiling), and where a structure
that no candidate explains sits.
"""

import numpy as np

from adaptsim_jax.sysid.estimate.linearize import Path


def generic_forces(path: Path, *, bumps: int = 7) -> np.ndarray:
    """Force columns `[K', W, n, L]` of unit RMS, about 48 a joint, on the fitted trajectory's rows."""
    columns = [c for j in range(path.u.shape[2]) for c in _at_joint(path, j, bumps)]
    return np.stack(columns).astype(np.float32)


def generic_names(joints: int, *, bumps: int = 7) -> list[tuple[str, str]]:
    """(joint, group) of each column of `generic_forces`; the groups are angle, speed, speed and angle, command, time (by itself, and
    what fades: a gain or a damping that drifts), past, other."""
    groups = ["angle"] * (bumps + 4) + ["speed"] * (bumps + 4) + ["speed and angle"] * 4 + ["command"] * 4
    groups += ["time"] * 8 + ["past"] * 6 + ["other"] * 4
    return [(f"joint{j + 1}", g) for j in range(joints) for g in groups]


def _at_joint(path: Path, j: int, bumps: int) -> list[np.ndarray]:
    n, dt = path.u.shape[2], path.dt
    middle = 0.5 * (path.x[:, 1:] + path.x[:, :-1])
    q, v, u = middle[..., j], middle[..., n + j], path.u[..., j]
    live = dt > 0
    t = path.time[:, :-1]
    functions = [*_bumps(q, live, bumps), np.sin(q), np.cos(q), np.sin(2 * q), np.cos(2 * q)]
    functions += [*_bumps(v, live, bumps), *(np.tanh(v / s) for s in _speeds(v, live)), v * np.abs(v)]
    way = np.tanh(v / _speeds(v, live)[1])
    functions += [v * np.sin(q), v * np.cos(q), way * np.sin(q), way * np.cos(q)]
    scale = np.sqrt(np.mean(u[live] ** 2)) + 1e-9
    functions += [u, np.abs(u), np.tanh(2 * u / scale), u**3 / scale**2]
    end = max(float(t.max()), 1e-6)
    waves = [np.cos(np.pi * k * t / end) for k in range(1, 5)]
    functions += waves + [z * wave for z in (u, v) for wave in waves[:2]]
    functions += [_past(z, dt, tau) for z in (u, v) for tau in (0.01, 0.03, 0.1)]
    other = 1 - j if n == 2 else (j + 1) % n
    p, w = middle[..., other], middle[..., n + other]
    functions += [np.sin(p), np.cos(p), w, v * np.sin(p)]
    return [_at(f * live, j, n) for f in functions]


def _bumps(z: np.ndarray, live: np.ndarray, count: int) -> list[np.ndarray]:
    """Gaussians centred on quantiles of `z`, as wide as the gaps between their neighbours."""
    centres = np.quantile(z[live], np.linspace(0.03, 0.97, count))
    width = np.maximum(np.gradient(centres), 0.3 * (centres[-1] - centres[0]) / count) + 1e-9
    return [np.exp(-0.5 * ((z - c) / w) ** 2) for c, w in zip(centres, width, strict=True)]


def _speeds(v: np.ndarray, live: np.ndarray) -> list[float]:
    top = float(np.quantile(np.abs(v[live]), 0.9)) + 1e-9
    return [0.02 * top, 0.1 * top, 0.4 * top]


def _past(z: np.ndarray, dt: np.ndarray, tau: float) -> np.ndarray:
    """How far `z [W, L]` is from its own first-order low-pass, begun at each window's first value."""
    keep, slow, out = np.exp(-dt / tau), z[:, 0], np.empty_like(z)
    for k in range(z.shape[1]):
        out[:, k] = z[:, k] - slow
        slow = z[:, k] + (slow - z[:, k]) * keep[:, k]
    return out


def _at(force: np.ndarray, j: int, n: int) -> np.ndarray:
    out = np.zeros((force.shape[0], n, force.shape[1]))
    out[:, j] = force / (np.sqrt(np.mean(force**2)) + 1e-12)
    return out
