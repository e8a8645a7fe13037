"""Neighbouring rows of a motion: its noise by differences, angle and speed by cubics."""

from collections.abc import Sequence
from math import comb

import numpy as np

from adaptsim_jax.logs.criteria import SIGNAL

NORMAL = 0.6745  # median size of a normal deviate, in standard deviations
ROUNDING = 1e-12  # of a channel's largest value: differences below it are those of floating point


def difference_noise(
    parts: Sequence[np.ndarray], order: int = 3, robust: bool = True, pooled: bool = False
) -> np.ndarray:
    """Standard deviation [...] of the noise of channels, 0 where no row tells of it.

    Args:
        parts: unbroken runs of rows [T, ...] at even steps, NaN where nothing was read.
        order: of the differences. A motion that is a polynomial of lower degree leaves none.
        robust: by the median of their sizes, which impacts hardly move. Else by their mean square.
        pooled: whether all channels have one noise, [1].
    """
    rows = [np.diff(z, order, axis=0) for z in parts]
    d = np.concatenate([z.reshape(-1, 1) for z in rows] if pooled else rows)
    out = np.zeros(d.shape[1:])
    has_rows = np.isfinite(d).any(0)
    if not has_rows.any():
        return out
    d = d[:, has_rows]
    if robust:
        noise = np.nanmedian(np.abs(d), axis=0) / NORMAL
    else:
        noise = np.sqrt(np.nanmean(np.square(d), axis=0))
    out[has_rows] = noise / np.sqrt(comb(2 * order, order))
    return out


ALIKE = 0.5  # of an encoder's step: with more noise than that few rows would read alike


def sensor_noise(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Estimate the same by medians, or by the mean square where most rows are rounded to one value:
    there at most `ALIKE` of the encoder's step, since all else is motion. Never less than rounding
    to those steps makes.
    """
    noise, rows = difference_noise(parts), np.concatenate(parts)
    is_noisy = noise > ROUNDING * np.max(np.abs(np.nan_to_num(rows)), axis=0)
    steps = [encoder_step(z) for z in rows.reshape(len(rows), -1).T]
    step = np.reshape(steps, rows.shape[1:])
    max_noise = np.where(step > 0.0, ALIKE * step, np.inf)
    rounded = np.minimum(difference_noise(parts, robust=False), max_noise)
    return np.maximum(np.where(is_noisy, noise, rounded), step / np.sqrt(12.0))


def encoder_step(z: np.ndarray) -> float:
    """The step between readings `[K]` (NaN where missing) that take few values; 0 where they take
    many.
    """
    values = np.unique(z[np.isfinite(z)])
    gaps = np.diff(values)
    steps = gaps[gaps > SIGNAL.value_tolerance * np.ptp(values)] if len(gaps) else gaps
    if not len(steps) or SIGNAL.min_rows_per_value * (len(steps) + 1) > len(z):
        return 0.0
    return float(np.min(steps))


def local_motion(
    time: np.ndarray, q: np.ndarray, v: np.ndarray | None, half: int = 7
) -> tuple[np.ndarray, np.ndarray]:
    """Angle and velocity `[T, n]` by least-squares cubics over `2 half + 1` neighbours
    (Savitzky-Golay, uneven rows).

    Measured velocities enter the same cubic. Good enough to start a fit.
    """
    count = min(2 * half + 1, len(time))
    first = np.clip(np.arange(len(time)) - half, 0, len(time) - count)
    neighbours = first[:, None] + np.arange(count)
    s = time[neighbours] - time[:, None]
    width = np.abs(s).max(1, keepdims=True)
    powers = (s / width)[..., None] ** np.arange(4)
    design, target = powers, q[neighbours]
    if v is not None:
        slopes = np.concatenate(
            [np.zeros_like(powers[..., :1]), np.arange(1, 4) * powers[..., :3]], -1
        )
        design = np.concatenate([design, slopes], 1)
        target = np.concatenate([target, v[neighbours] * width[..., None]], 1)
    is_read = np.isfinite(target)
    channels = [
        (np.where(is_read, target, 0.0)[..., j], is_read[..., j]) for j in range(q.shape[1])
    ]
    coef = np.stack([_cubic(design, y, k) for y, k in channels], -1)  # [T, 4, n]
    return coef[:, 0], coef[:, 1] / width


def _cubic(design: np.ndarray, target: np.ndarray, is_read: np.ndarray) -> np.ndarray:
    """Coefficients `[T, 4]` of weighted least squares."""
    masked_design = design * is_read[..., None]
    normal = np.swapaxes(masked_design, 1, 2) @ design + 1e-9 * np.eye(4)
    return np.linalg.solve(normal, (np.swapaxes(masked_design, 1, 2) @ target[..., None]))[..., 0]
