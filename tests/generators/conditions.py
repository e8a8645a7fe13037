"""The conditions under which a recording is made: sensors, clock, disturbance, kind of trials."""

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class Condition:
    """Sensor standard deviations [rad, rad/s], encoder bits a turn (0: none), clock, disturbance,
    trials.
    """

    q_noise: tuple[float, float] = (5e-5, 3e-4)  # drawn log-uniformly between
    v_noise: tuple[float, float] = (1e-3, 8e-3)
    velocities: bool = True
    bits: tuple[int, int] = (0, 0)  # drawn between, inclusive
    rates: tuple[float, ...] = ()  # drawn from; empty: the caller's
    jitter: float = 0.0  # standard deviation of a row's lateness, in periods
    dropouts: float = 0.0  # share of rows after which the loop skips 1-6 periods
    disturbance: tuple[float, float] = (0.0, 0.0)  # RMS share of the torque's RMS, drawn between
    kinds: tuple[str, ...] = ()  # trial kinds; empty: the mixed default
    n_trials: int = 0  # 0: the caller's
    seconds: float = 0.0


CLEAN = Condition()
CONDITIONS: dict[str, Condition] = {
    "clean": CLEAN,
    "low_noise": replace(CLEAN, q_noise=(1e-5, 5e-5), v_noise=(2e-4, 1e-3)),
    "high_noise": replace(CLEAN, q_noise=(1e-3, 4e-3), v_noise=(2e-2, 8e-2)),
    "coloured": replace(CLEAN, disturbance=(0.01, 0.05)),
    "quantised": replace(CLEAN, bits=(12, 16), velocities=False, q_noise=(1e-6, 1e-5)),
    "jitter": replace(CLEAN, jitter=0.15, dropouts=0.01),
    "closed_loop": replace(CLEAN, kinds=("tracking",)),
    "slow": replace(CLEAN, rates=(50.0, 80.0, 100.0)),
    "few_short": replace(CLEAN, n_trials=3, seconds=3.0),
    "one_long": replace(CLEAN, n_trials=1, seconds=30.0),
    "swings": replace(CLEAN, kinds=("swing", "swing", "multisine")),
    "no_velocity": replace(CLEAN, velocities=False),
    "fast": replace(CLEAN, rates=(400.0, 500.0), seconds=4.0),
    "open_loop": replace(CLEAN, kinds=("open_upright",), n_trials=12, seconds=0.7),
}
NULL_CONDITIONS = (
    "low_noise",
    "high_noise",
    "coloured",
    "quantised",
    "jitter",
    "closed_loop",
    "slow",
    "few_short",
)


def log_uniform(rng: np.random.Generator, span: tuple[float, float]) -> float:
    return float(np.exp(rng.uniform(np.log(span[0]), np.log(span[1]))))


def row_times(rng: np.random.Generator, c: Condition, rate: float, seconds: float) -> np.ndarray:
    """Row times `[K]` from 0: uniform, or late by a random part of a period, now and then by
    several periods.
    """
    count = round(seconds * rate)
    if c.jitter == 0 and c.dropouts == 0:
        return np.arange(count) / rate
    gaps = np.ones(count) + (rng.random(count) < c.dropouts) * rng.integers(1, 7, count)
    ticks = np.concatenate([[0.0], np.cumsum(gaps)])
    late = np.clip(rng.normal(0, c.jitter, len(ticks)), -0.45, 0.45)
    late[0] = 0.0
    times = (ticks + late) / rate
    return times[times <= seconds]


def ornstein_uhlenbeck(
    rng: np.random.Generator, times: np.ndarray, rms: np.ndarray, tau: float
) -> np.ndarray:
    """A stationary coloured disturbance `[K, 2]` with standard deviation `rms` `[2]`, sampled at
    `times`.
    """
    keep = np.exp(-np.diff(times, prepend=times[0]) / tau)
    out = np.empty((len(times), 2))
    x = rng.normal(size=2)
    for k, a in enumerate(keep):
        x = a * x + np.sqrt(1 - a * a) * rng.normal(size=2)
        out[k] = x
    return out * rms
