"""Whether two records agree: velocity and slope, two torques, stamps and angles."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from adaptsim_jax.logs.criteria import AGREEMENT, JITTER
from adaptsim_jax.logs.noise import difference_noise


@dataclass(frozen=True)
class Agreement:
    """`second = gain first(t - lag)`, and a constant; `r2`: the share of the variance that this
    explains.

    - `enough`: There is signal enough to judge by, and they are related.
    - `loud`: There is signal enough.
    - `spread`: Standard error of the gain.
    """

    gain: float
    lag: float
    r2: float
    enough: bool
    loud: bool = True
    spread: float = 0.0


NOT_ENOUGH = Agreement(1.0, 0.0, 0.0, False, False)


def velocity_agreement(time: np.ndarray, q: np.ndarray, v: np.ndarray) -> Agreement:
    """How a measured velocity `v: [T]` relates to the slope of `q: [T]`: v = gain dq/dt(t - lag) +
    offset.

    Compares the mean velocity over a stretch with the angle's change, so that noise averages out
    and uneven sampling is exact (trapezoid). A lag shows as a term in the acceleration. Steps that
    stand out (a wrap, a lost row) are trimmed. The slope is the noisier of the two, so it is what
    is regressed on the other.
    """
    dt = np.diff(time)
    area = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * dt)])
    span = min(
        max(AGREEMENT.min_span, round(AGREEMENT.span / float(np.median(dt)))), len(time) // 4
    )
    width = time[span:] - time[:-span]
    mean_v = (area[span:] - area[:-span]) / width
    slope = (q[span:] - q[:-span]) / width
    acceleration = (v[span:] - v[:-span]) / width
    if np.std(slope) == 0 or np.std(mean_v) == 0:
        return NOT_ENOUGH
    (inverse, lead, _), spread, r2 = _regress(mean_v, acceleration, slope, span)
    is_loud = bool(
        np.std(slope) > AGREEMENT.min_signal_ratio * _angle_noise(q) / float(np.median(width))
    )
    if inverse == 0 or r2 < AGREEMENT.min_r2:
        return Agreement(0.0, 0.0, r2, False, is_loud)
    return Agreement(1 / inverse, lead / inverse, r2, True, is_loud, spread / inverse**2)


def _angle_noise(q: np.ndarray) -> float:
    """Rough noise of an angle `q: [T]`, from its fourth difference and its resolution."""
    change = np.abs(np.diff(q))
    steps = change[change > 0]
    return max(
        float(difference_noise([q], 4)),
        float(np.min(steps)) / 3.5 if len(steps) else 0.0,
    )


def _regress(
    first: np.ndarray, second: np.ndarray, target: np.ndarray, span: int
) -> tuple[np.ndarray, float, float]:
    """Trimmed least squares on both and a constant: coefficients `[3]`, std error of the first,
    R2.
    """
    is_kept = np.ones(len(target), bool)
    design = np.stack([first, second, np.ones_like(first)], axis=1)
    scale = np.maximum(np.std(design, axis=0), 1e-300)
    scale[2] = 1.0
    coef = np.zeros(3)
    for _ in range(3):
        coef = np.linalg.lstsq(design[is_kept] / scale, target[is_kept], rcond=None)[0]
        residual = np.abs(target - design / scale @ coef)
        is_kept = residual <= max(
            AGREEMENT.trim_deviations * 1.4826 * float(np.median(residual[is_kept])), 1e-12
        )
    residual_variance = float(np.var(target[is_kept] - design[is_kept] / scale @ coef))
    total = float(np.var(target[is_kept]))
    # Overlapping stretches repeat each other: one in `span` is independent.
    spread = np.sqrt(residual_variance * span / max(is_kept.sum(), 1)) / scale[0]
    return coef / scale, float(spread), 1.0 - residual_variance / total if total > 0 else 0.0


def command_agreement(
    time: np.ndarray,
    command: np.ndarray,
    measured: np.ndarray,
    max_lag: int = AGREEMENT.max_late_rows,
) -> Agreement:
    """measured = gain command(t - lag) + offset; lag in s: the best of `max_lag` samples and a
    parabola.
    """
    if np.std(command) < 1e-9 or np.std(measured) < 1e-9 or len(time) <= 3 * max_lag:
        return NOT_ENOUGH
    n = len(time)
    lags = np.arange(-AGREEMENT.max_early_rows, max_lag + 1)
    body = slice(max_lag, n - max_lag)
    shifted = np.stack([np.roll(command, k)[body] for k in lags], axis=1)
    shifted = shifted - shifted.mean(axis=0)
    y = measured[body] - measured[body].mean()
    power = np.maximum(np.sum(shifted**2, axis=0), 1e-300)
    r2 = (shifted.T @ y) ** 2 / (power * np.sum(y**2))
    best = int(np.argmax(r2))
    shift = 0.0
    if 0 < best < len(lags) - 1:
        left, mid, right = r2[best - 1 : best + 2]
        curve = left - 2 * mid + right
        shift = 0.5 * (left - right) / curve if curve < 0 else 0.0
    gain = float(shifted[:, best] @ y / power[best])
    lag = float((lags[best] + shift) * np.median(np.diff(time)))
    return Agreement(gain, lag, float(r2[best]), bool(r2[best] > AGREEMENT.min_command_r2))


def lattice_step(x: np.ndarray) -> float:
    """Quantisation step of `x: [T]`: the largest spacing of a lattice that holds its values, 0 if
    none.
    """
    values = np.unique(x)
    gaps = np.diff(values)
    if len(values) < 4:
        if len(gaps):
            return float(gaps.min())
        return 0.0
    tiny = 1e-6 * float(np.max(np.abs(values)))
    gaps = gaps[gaps > tiny]
    if len(gaps) < 3:
        return 0.0
    guesses = np.unique(np.quantile(gaps, [0.5, 0.3, 0.2, 0.1, 0.05, 0.02, 0.0]))[::-1]
    for guess in guesses:
        step = _refine(values, float(guess))
        if step > 0:
            return step
    return 0.0


def _refine(values: np.ndarray, guess: float) -> float:
    """Least-squares step of the lattice near `guess`, or 0 where the values are not on one."""
    gaps = np.diff(values)
    near_gaps = gaps[np.abs(gaps / guess - 1) < 0.25]
    if not len(near_gaps):
        return 0.0
    step = float(np.mean(near_gaps))
    for _ in range(3):
        index = np.concatenate([[0.0], np.cumsum(np.round(gaps / step))])
        if index[-1] < 3 or index[-1] > 1e7:
            return 0.0
        step, start = np.polyfit(index, values, 1)
    offset = np.abs(values - (start + step * index)) / step
    share_single = np.mean(np.diff(index) == 0)
    share_outliers = np.mean(offset > AGREEMENT.lattice_off)
    if share_outliers < AGREEMENT.lattice_outliers and share_single < AGREEMENT.lattice_same:
        return float(step)
    return 0.0


STENCIL = (-2, -1, 1, 2)


@dataclass(frozen=True)
class Jitter:
    """`times`: even times of each trial `[T]`; `size`: standard deviation of the stamps about them,
    s; `share` of it that the angles do not follow.
    """

    times: tuple[np.ndarray, ...]
    size: float
    share: float


def jitter(trials: Sequence[tuple[np.ndarray, np.ndarray]]) -> Jitter | None:
    """Estimate the jitter of stamps of trials (time [T] s, q [T, n], NaN where missing); None where
    stamps are even, or right, or where that cannot be told.
    """
    evens = [e for time, _ in trials if (e := even_times(time)) is not None]
    if len(evens) < len(trials):
        return None
    off = [time - e for (time, _), e in zip(trials, evens, strict=True)]
    step = float(np.median(np.concatenate([np.diff(time) for time, _ in trials])))
    size = float(np.std(np.concatenate(off)))
    if size < JITTER.max_uneven_share * step:
        return None
    top = bottom = total = 0.0
    count = 0
    for (time, q), e, d in zip(trials, evens, off, strict=True):
        for j in range(q.shape[1]):
            if len(time) < JITTER.min_rows or not np.all(np.isfinite(q[:, j])):
                continue
            residual = _cubic_residual(time, q[:, j])
            x = _cubic_residual(time, -np.gradient(q[:, j], e) * d)
            gain = 1.0 / max(
                float(np.median(np.abs(residual))) ** 2, 1e-24
            )  # joints count by their own noise
            top += gain * float(x @ residual)
            bottom += gain * float(x @ x)
            total += gain * float(residual @ residual)
            count += len(x)
    if not bottom > 0.0 or count < JITTER.min_count:
        return None
    share = top / bottom
    error = np.sqrt(max(total - share * top, 1e-300) / count / bottom)
    if (
        share < JITTER.min_share
        or share > 2.0 - JITTER.min_share
        or share < JITTER.min_standard_errors * error
    ):
        return None
    return Jitter(tuple(e for e in evens if e is not None), size, share)


def even_times(time: np.ndarray) -> np.ndarray | None:
    """Fit even times [T] s to stamps of rows of which some may be missing; None where stamps
    are farther off than half a row.
    """
    step = float(np.median(np.diff(time)))
    if len(time) < 3 or not step > 0:
        return None
    n_steps = round(float(time[-1] - time[0]) / step)
    if n_steps == len(time) - 1:
        index = np.arange(len(time))
    else:
        index = np.cumsum(np.round(np.diff(time, prepend=time[0]) / step))
    if np.any(np.diff(index) < 1):
        return None
    slope, begin = np.polyfit(index, time, 1)
    out = begin + slope * index
    if np.max(np.abs(time - out)) < JITTER.max_offset_rows * step:
        return out
    return None


def _cubic_residual(time: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Values `[T - 4]` less what the cubic through their two neighbours on each side foretells."""
    middle = np.arange(2, len(time) - 2)
    t = np.stack([time[middle + k] for k in STENCIL])
    out = x[middle].copy()
    for a in range(4):
        weight = np.ones(len(middle))
        for b in range(4):
            if a != b:
                weight *= (time[middle] - t[b]) / (t[a] - t[b])
        out -= weight * x[middle + STENCIL[a]]
    return out
