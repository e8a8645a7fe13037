"""The noise floor of a recording's sensors, and a smoother that uses it.

The estimate is the marginal likelihood of an integrated random walk on windows of each trial
(`smoother.py`), which is a difference method with exact variance factors on uneven grids. The
median over windows guards against signal that leaks into the noise (impacts, stiction);
quantisation sets a least value, step/sqrt(12).
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from adaptsim_jax.logs.noise import smoother
from adaptsim_jax.logs.types import Recording, Trial

if TYPE_CHECKING:
    from adaptsim_jax.logs.quality.findings import Audit

WINDOW = 300
"""Samples a window: long enough to tell noise from motion, short enough for the motion to be of one
kind.
"""
COARSE = 0.0
"""Log signal-to-noise ratio of one step above which a smoother prior (white snap) is tried as well.
"""
ROUGH = 2.5
"""Log ratio above which white jerk is too rough a prior for the sampling, and white snap is used.
"""
APART = 1.4
"""The two priors' estimates further apart than this: the motion between two samples hides the
noise.
"""
DISAGREE = 2.0
"""Declared and estimated noise further apart than this factor are reported, and the larger one is
used.
"""


def noise_floor(recording: Recording, audit: "Audit") -> dict[str, float]:
    """Noise std of every measured channel (`q1`, `q2` rad; `v1`, `v2` rad/s where measured):
    declared, else from repeats, else from the smoothing residual.

    A declared value is used as declared unless the estimate differs by more than a factor of two:
    then the larger is used, because too small a floor makes effects out of noise.
    """
    fits = [_trial_fits(t, audit.valid.get(t.name)) for t in recording.trials]
    repeated, std = _from_repeats(recording), {}
    for c in sorted({c for by in fits for c in by}):
        own = [by[c] for by in fits if c in by]
        hidden = float(np.mean([share for _, share in own])) >= 0.5
        least = max(audit.quantisation.get(c, 0.0) / np.sqrt(12.0), 1e-12)
        estimated = max(repeated.get(c, float(np.median([size for size, _ in own]))), least)
        std[c] = _choose(recording.noise.get(c), estimated, hidden)
    return std


def _choose(declared: float | None, estimate: float, hidden: bool) -> float:
    if not declared:
        return estimate
    if hidden or 1 / DISAGREE <= estimate / declared <= DISAGREE:
        return declared
    return max(estimate, declared)


def _channels(trial: Trial) -> dict[str, np.ndarray]:
    both = {"q1": trial.q[:, 0], "q2": trial.q[:, 1]}
    if trial.v is None:
        return both
    return both | {"v1": trial.v[:, 0], "v2": trial.v[:, 1]}


def _trial_fits(trial: Trial, valid: np.ndarray | None) -> dict[str, tuple[float, float]]:
    """Channel -> (noise std, share of windows that hide it) over the valid rows of the trial."""
    if valid is None or valid.sum() < 20:
        keep = np.ones(len(trial.time), bool)
    else:
        keep = valid
    time = trial.time[keep]
    return {c: estimate(time, y[keep]) for c, y in _channels(trial).items()}


def estimate(time: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Noise std of one signal `y: [T]` at `time: [T]` s, and the share of its windows that hide the
    noise.
    """
    windows = np.array_split(np.arange(len(y)), max(1, len(y) // WINDOW))
    fits = [fit_window(time[w], y[w]) for w in windows]
    # A window at rest in a quantised channel shows no noise at all: it says nothing about the
    # moving sensor.
    seen = [f for f in fits if f[0] > 0] or fits
    return float(np.median([std for std, _ in seen])), float(
        np.mean([hidden for _, hidden in seen])
    )


def fit_window(time: np.ndarray, y: np.ndarray) -> tuple[float, bool]:
    """Noise std of a short signal, and whether the motion hides it (then a guess between two
    priors).
    """
    jerk = smoother.fit_noise(time, y, 3)
    if jerk.log_ratio < COARSE or jerk.std == 0:
        return jerk.std, False
    snap = smoother.fit_noise(time, y, 4)
    if snap.std > APART * jerk.std:
        return float(np.sqrt(snap.std * jerk.std)), True
    return (snap.std if jerk.log_ratio > ROUGH else jerk.std), False


def _from_repeats(recording: Recording) -> dict[str, float]:
    """Noise from differences of trials that repeat one command from one state: the motion cancels
    in them.
    """
    found: dict[str, list[float]] = {}
    trials = recording.trials
    for i, a in enumerate(trials):
        for b in trials[i + 1 :]:
            n = min(len(a.time), len(b.time))
            if not repeats(a, b):
                continue
            one, two = _channels(a), _channels(b)
            for c in set(one) & set(two):
                difference = (one[c][:n] - two[c][:n]) / np.sqrt(2.0)
                found.setdefault(c, []).append(estimate(a.time[:n], difference)[0])
    return {c: float(np.median(s)) for c, s in found.items()}


def repeats(a: Trial, b: Trial) -> bool:
    """Whether `b` repeats `a`: one command at the same times from nearly one state, but not a
    copy.
    """
    n = min(len(a.time), len(b.time))
    if n < 0.9 * max(len(a.time), len(b.time)) or np.array_equal(a.q[:n], b.q[:n]):
        return False
    one, two = (t.torque if t.commanded is None else t.commanded for t in (a, b))
    size = max(float(np.std(one[:n])), 1e-9)
    shift = a.time[:n] - a.time[0] - (b.time[:n] - b.time[0])
    same_time = np.max(np.abs(shift)) < 0.25 * a.dt
    same_command = np.sqrt(np.mean((one[:n] - two[:n]) ** 2)) < 0.01 * size
    spread = np.ptp(a.q, axis=0) + 1e-9
    same_start = np.all(np.abs(a.q[0] - b.q[0]) < 0.05 * spread)
    return bool(same_time and same_command and same_start)


def smooth(trial: Trial, noise: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities `[T, 2]`, rad and rad/s: posterior mean of the motion given angles,
    and velocities where they agree with the angles.

    The walk's intensity follows the motion window by window. Measured velocities are dropped for a
    joint where using them makes the angles fit worse than their noise allows (a lagging filter, a
    wrong scale).
    """
    joints = [_smooth_joint(trial, noise, j) for j in range(2)]
    q, v = (np.stack([states[:, k] for states in joints], axis=1) for k in range(2))
    return q, v


def _smooth_joint(trial: Trial, noise: Mapping[str, float], joint: int) -> np.ndarray:
    """Angle and velocity `[T, 2]`."""
    q, sq = trial.q[:, joint], max(noise[f"q{joint + 1}"], 1e-9)
    sv = noise.get(f"v{joint + 1}", 0.0)
    order, levels = _intensity(trial.time, q, sq)
    prior = smoother.make_prior(trial.time, order, levels)
    alone = _states(prior, q, sq, None, 0.0)
    if trial.v is None or sv <= 0:
        return alone
    both = _states(prior, q, sq, trial.v[:, joint], sv)
    least = max(sq**2, float(np.mean((q - alone[:, 0]) ** 2)))
    if np.mean((q - both[:, 0]) ** 2) > 1.3 * least:
        return alone
    return both


def _intensity(time: np.ndarray, q: np.ndarray, std: float) -> tuple[int, np.ndarray]:
    """Order of the walk and its intensity `[T - 1]` over the noise, by maximum likelihood per
    window.
    """
    windows = np.array_split(np.arange(len(q)), max(1, len(q) // WINDOW))
    logs = np.array([_level(time[w], q[w], std, 3) for w in windows])
    order = 4 if np.median(logs) > ROUGH else 3
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
    prior = smoother.make_prior(time, order)
    weights = [np.ones(len(q))] + [None] * (order - 1)
    data = [smoother.detrend(time, q, order) / std] + [None] * (order - 1)

    def objective(log_ratio: float) -> float:
        _, factor, quad = smoother.posterior(prior, float(np.exp(log_ratio)), weights, data)
        return quad + order * (prior.size - 1) * log_ratio + 2.0 * float(np.sum(np.log(factor[0])))

    return smoother.minimise(objective, (-18.0, 14.0), 0.2)


def _states(
    prior: smoother.Prior, q: np.ndarray, sq: float, v: np.ndarray | None, sv: float
) -> np.ndarray:
    """Posterior mean of angle and velocity `[T, 2]` in SI units."""
    h, m = prior.step, prior.order
    offset = q.mean()
    weights: list = [np.ones(len(q))] + [None] * (m - 1)
    data: list = [(q - offset) / sq] + [None] * (m - 1)
    if v is not None:
        weights[1] = np.full(len(q), (sq / (sv * h)) ** 2)
        data[1] = v * h / sq
    mean = smoother.posterior(prior, 1.0, weights, data)[0][:, :2]
    return mean * sq / h ** np.arange(2) + np.array([offset, 0.0])
