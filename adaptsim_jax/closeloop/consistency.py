"""Do two records of the same motion agree: velocity with d(angle)/dt, measured with commanded torque."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Agreement:
    """`second = gain * first(t - lag) + offset`, and `r2`, the share of the variance that this explains."""

    gain: float
    lag: float
    offset: float
    r2: float
    enough: bool


NOT_ENOUGH = Agreement(1.0, 0.0, 0.0, 0.0, False)


def velocity_agreement(time: np.ndarray, q: np.ndarray, v: np.ndarray, span: int = 8) -> Agreement:
    """How a measured velocity `v: [T]` relates to the slope of `q: [T]`: v = gain dq/dt(t - lag) + offset.

    Compares the mean velocity over `span` steps with the angle's change, so that noise averages out and
    uneven sampling is exact (trapezoid). A lag shows as a term in the acceleration. Steps that stand out
    (a wrap, a lost row) are trimmed.
    """
    dt = np.diff(time)
    area = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * dt)])
    span = min(span, len(time) // 4)
    width = time[span:] - time[:-span]
    mean_v = (area[span:] - area[:-span]) / width
    slope = (q[span:] - q[:-span]) / width
    bend = np.gradient(slope, 0.5 * (time[span:] + time[:-span]))
    if np.std(slope) == 0 or np.std(mean_v) == 0:
        return NOT_ENOUGH
    gain, lag, offset, r2 = _regress(slope, bend, mean_v)
    return Agreement(gain, -lag / gain if gain else 0.0, offset, r2, r2 > 0.5)


def _regress(slope: np.ndarray, bend: np.ndarray, target: np.ndarray) -> tuple[float, float, float, float]:
    keep = np.ones(len(slope), bool)
    design = np.stack([slope, bend, np.ones_like(slope)], axis=1)
    scale = np.maximum(np.std(design, axis=0), 1e-300)
    scale[2] = 1.0
    coef = np.zeros(3)
    for _ in range(3):
        coef = np.linalg.lstsq(design[keep] / scale, target[keep], rcond=None)[0]
        residual = np.abs(target - design / scale @ coef)
        keep = residual <= max(6.0 * 1.4826 * float(np.median(residual[keep])), 1e-12)
    rest = target[keep] - design[keep] / scale @ coef
    total = float(np.var(target[keep]))
    gain, lag, offset = coef / scale
    return float(gain), float(lag), float(offset), 1.0 - float(np.var(rest)) / total if total > 0 else 0.0


def command_agreement(
    time: np.ndarray, command: np.ndarray, measured: np.ndarray, most: int = 40
) -> Agreement:
    """measured = gain command(t - lag) + offset; lag in s: the best of `most` samples and a parabola."""
    if np.std(command) < 1e-9 or np.std(measured) < 1e-9 or len(time) <= 3 * most:
        return NOT_ENOUGH
    n = len(time)
    lags = np.arange(-5, most + 1)
    body = slice(most, n - most)
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
    return Agreement(
        gain, lag, float(measured.mean() - gain * command.mean()), float(r2[best]), bool(r2[best] > 0.3)
    )


def lattice_step(x: np.ndarray) -> float:
    """Quantisation step of `x: [T]`: the largest spacing of a lattice that holds its values, 0 if none."""
    values = np.unique(x)
    gaps = np.diff(values)
    if len(values) < 4:
        return float(gaps.min()) if len(gaps) else 0.0
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
    near = gaps[np.abs(gaps / guess - 1) < 0.25]
    if not len(near):
        return 0.0
    step = float(np.mean(near))
    for _ in range(3):
        index = np.concatenate([[0.0], np.cumsum(np.round(gaps / step))])
        if index[-1] < 3 or index[-1] > 1e7:
            return 0.0
        step, start = np.polyfit(index, values, 1)
    off = np.abs(values - (start + step * index)) / step
    single = np.mean(np.diff(index) == 0)
    return float(step) if np.mean(off > 0.15) < 0.02 and single < 0.05 else 0.0
