"""Angle and speed of a logged motion by local cubics: where the fit of a stretch begins."""

import numpy as np


def local_motion(
    time: np.ndarray, q: np.ndarray, v: np.ndarray | None, half: int = 7
) -> tuple[np.ndarray, np.ndarray]:
    """Angle and velocity `[T, n]` by least-squares cubics over `2 half + 1` neighbours
    (Savitzky-Golay, uneven rows).

    Measured velocities enter the same cubic. Good enough to start a fit.
    """
    count = min(2 * half + 1, len(time))
    first = np.clip(np.arange(len(time)) - half, 0, len(time) - count)
    near = first[:, None] + np.arange(count)
    s = time[near] - time[:, None]
    width = np.abs(s).max(1, keepdims=True)
    powers = (s / width)[..., None] ** np.arange(4)
    design, target = powers, q[near]
    if v is not None:
        slopes = np.concatenate(
            [np.zeros_like(powers[..., :1]), np.arange(1, 4) * powers[..., :3]], -1
        )
        design, target = (
            np.concatenate([design, slopes], 1),
            np.concatenate([target, v[near] * width[..., None]], 1),
        )
    keep = np.isfinite(target)
    channels = [(np.where(keep, target, 0.0)[..., j], keep[..., j]) for j in range(q.shape[1])]
    coef = np.stack([_cubic(design, y, k) for y, k in channels], -1)  # [T, 4, n]
    return coef[:, 0], coef[:, 1] / width


def _cubic(design: np.ndarray, target: np.ndarray, keep: np.ndarray) -> np.ndarray:
    """Coefficients `[T, 4]` of weighted least squares."""
    kept = design * keep[..., None]
    normal = np.swapaxes(kept, 1, 2) @ design + 1e-9 * np.eye(4)
    return np.linalg.solve(normal, (np.swapaxes(kept, 1, 2) @ target[..., None]))[..., 0]
