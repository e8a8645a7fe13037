"""The noise floor of a recording's sensors, and a smoother that uses it.

The estimate is the marginal likelihood of an integrated random walk on windows of each trial (`smoother.py`),
which is a difference method with exact variance factors on uneven grids. The median over windows guards
against signal that leaks into the noise (impacts, stiction); quantisation sets a least value, step/sqrt(12).
"""

from dataclasses import dataclass, field

import numpy as np

from adaptsim_jax.logs.noise import smoother
from adaptsim_jax.logs.quality.findings import Audit
from adaptsim_jax.logs.types import Recording, Trial

WINDOW = 300
"""Samples a window: long enough to tell noise from motion, short enough for the motion to be of one kind."""
COARSE = 0.0
"""Log signal-to-noise ratio of one step above which a smoother prior (white snap) is tried as well."""
ROUGH = 2.5
"""Log ratio above which white jerk is too rough a prior for the sampling, and white snap is used."""
APART = 1.4
"""The two priors' estimates further apart than this: the motion between two samples hides the noise."""
DISAGREE = 2.0
"""Declared and estimated noise further apart than this factor are reported, and the larger one is used."""


@dataclass(frozen=True)
class NoiseFloor:
    """Sensor noise by channel (`q1`, `q2` rad; `v1`, `v2` rad/s where measured) and where it comes from.

    `source` is `declared`, `repeats` or `smoothing` (of the majority of channels; `sources` has each).
    `estimated` is the estimate whatever was declared; `per_trial` its value in each trial; `unresolved`
    lists the channels in which the sampling is too slow to tell noise from motion.
    """

    std: dict[str, float]
    source: str
    quantisation: dict[str, float]
    per_trial: dict[str, dict[str, float]]
    message: str
    sources: dict[str, str] = field(default_factory=dict)
    estimated: dict[str, float] = field(default_factory=dict)
    unresolved: tuple[str, ...] = ()


def noise_floor(recording: Recording, audit: Audit) -> NoiseFloor:
    """Noise std of every measured channel: declared, else from repeats, else from the smoothing residual.

    A declared value is used as declared unless the estimate differs by more than a factor of two: then the
    larger is used, because too small a floor makes effects out of noise, and the message says so.
    """
    fits = {t.name: _trial_fits(t, audit.valid.get(t.name)) for t in recording.trials}
    per_trial = {name: {c: f[0] for c, f in by.items()} for name, by in fits.items()}
    channels = sorted({c for by in per_trial.values() for c in by})
    smoothed = {c: float(np.median([by[c] for by in per_trial.values() if c in by])) for c in channels}
    hidden = {c: float(np.mean([by[c][1] for by in fits.values() if c in by])) >= 0.5 for c in channels}
    repeats = _from_repeats(recording)
    std, sources, estimated, remarks = {}, {}, {}, []
    for c in channels:
        floor = audit.quantisation.get(c, 0.0) / np.sqrt(12.0)
        estimated[c] = max(repeats.get(c, smoothed[c]), floor, 1e-12)
        source = "repeats" if c in repeats else "smoothing"
        std[c], sources[c], remark = _choose(c, recording.noise.get(c), estimated[c], source, hidden[c])
        remarks += [remark] if remark else []
    unresolved = tuple(c for c in channels if hidden[c] and sources[c] == "smoothing")
    if unresolved:
        remarks.append(f"sampling is too slow to tell noise from motion in {', '.join(unresolved)}")
    return NoiseFloor(
        std=std,
        source=max(sorted(set(sources.values())), key=list(sources.values()).count, default="smoothing"),
        quantisation=dict(audit.quantisation),
        per_trial=per_trial,
        message="; ".join([_summary(std, sources), *remarks]),
        sources=sources,
        estimated=estimated,
        unresolved=unresolved,
    )


def _choose(channel: str, declared: float | None, estimate: float, source: str, hidden: bool) -> tuple[float, str, str]:
    """The noise to use, its source, and a remark where declared and estimated disagree."""
    if not declared:
        return estimate, source, ""
    if hidden or 1 / DISAGREE <= estimate / declared <= DISAGREE:
        return declared, "declared", ""
    used = max(estimate, declared)
    remark = f"{channel}: declared {declared:.3g}, the data show {estimate:.3g}; the larger is used"
    return used, "declared" if used == declared else source, remark


def _summary(std: dict[str, float], sources: dict[str, str]) -> str:
    units = {"q": "rad", "v": "rad/s"}
    if not std:
        return "no usable trial to take the noise from"
    return "noise " + ", ".join(f"{c} {s:.3g} {units[c[0]]} ({sources[c]})" for c, s in std.items())


def _channels(trial: Trial) -> dict[str, np.ndarray]:
    both = {"q1": trial.q[:, 0], "q2": trial.q[:, 1]}
    return both if trial.v is None else both | {"v1": trial.v[:, 0], "v2": trial.v[:, 1]}


def _trial_fits(trial: Trial, valid: np.ndarray | None) -> dict[str, tuple[float, float]]:
    """Channel -> (noise std, share of windows that hide it) over the valid rows of the trial."""
    keep = np.ones(len(trial.time), bool) if valid is None or valid.sum() < 20 else valid
    time = trial.time[keep]
    return {c: estimate(time, y[keep]) for c, y in _channels(trial).items()}


def estimate(time: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Noise std of one signal `y: [T]` at `time: [T]` s, and the share of its windows that hide the noise."""
    windows = np.array_split(np.arange(len(y)), max(1, len(y) // WINDOW))
    fits = [fit_window(time[w], y[w]) for w in windows]
    # A window at rest in a quantised channel shows no noise at all: it says nothing about the moving sensor.
    seen = [f for f in fits if f[0] > 0] or fits
    return float(np.median([std for std, _ in seen])), float(np.mean([hidden for _, hidden in seen]))


def fit_window(time: np.ndarray, y: np.ndarray) -> tuple[float, bool]:
    """Noise std of a short signal, and whether the motion hides it (then a guess between two priors)."""
    jerk = smoother.fit_noise(time, y, 3)
    if jerk.log_ratio < COARSE or jerk.std == 0:
        return jerk.std, False
    snap = smoother.fit_noise(time, y, 4)
    if snap.std > APART * jerk.std:
        return float(np.sqrt(snap.std * jerk.std)), True
    return (snap.std if jerk.log_ratio > ROUGH else jerk.std), False


def _from_repeats(recording: Recording) -> dict[str, float]:
    """Noise from differences of trials that repeat one command from one state: the motion cancels in them."""
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
    """Whether `b` repeats `a`: one command at the same times from nearly one state, but not a copy."""
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


@dataclass(frozen=True)
class Smoothed:
    """Smoothed motion of a trial: `q, v, a: [T, 2]` in rad, rad/s, rad/s^2; `used_velocity: [2]` by joint."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    used_velocity: tuple[bool, bool]


def smooth(trial: Trial, noise: NoiseFloor) -> tuple[np.ndarray, np.ndarray]:
    """Smoothed positions and velocities `[T, 2]`, rad and rad/s; see `smooth_motion`."""
    motion = smooth_motion(trial, noise)
    return motion.q, motion.v


def smooth_motion(trial: Trial, noise: NoiseFloor) -> Smoothed:
    """Posterior mean of the motion given angles, and velocities where they agree with the angles.

    The walk's intensity follows the motion window by window. Measured velocities are dropped for a joint
    where using them makes the angles fit worse than their noise allows (a lagging filter, a wrong scale).
    """
    joints = [_smooth_joint(trial, noise, j) for j in range(2)]
    q, v, a = (np.stack([states[:, k] for states, _ in joints], axis=1) for k in range(3))
    return Smoothed(q, v, a, (joints[0][1], joints[1][1]))


def _smooth_joint(trial: Trial, noise: NoiseFloor, joint: int) -> tuple[np.ndarray, bool]:
    q, sq = trial.q[:, joint], max(noise.std[f"q{joint + 1}"], 1e-9)
    sv = noise.std.get(f"v{joint + 1}", 0.0)
    order, levels = _intensity(trial.time, q, sq)
    prior = smoother.make_prior(trial.time, order, levels)
    alone = _states(prior, q, sq, None, 0.0)
    if trial.v is None or sv <= 0:
        return alone, False
    both = _states(prior, q, sq, trial.v[:, joint], sv)
    least = max(sq**2, float(np.mean((q - alone[:, 0]) ** 2)))
    worse = bool(np.mean((q - both[:, 0]) ** 2) > 1.3 * least)
    return (alone, False) if worse else (both, True)


def _intensity(time: np.ndarray, q: np.ndarray, std: float) -> tuple[int, np.ndarray]:
    """Order of the walk and its intensity `[T - 1]` over the noise, by maximum likelihood per window."""
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


def _states(prior: smoother.Prior, q: np.ndarray, sq: float, v: np.ndarray | None, sv: float) -> np.ndarray:
    """Posterior mean of angle, velocity and acceleration `[T, 3]` in SI units."""
    h, m = prior.step, prior.order
    offset = q.mean()
    weights: list = [np.ones(len(q))] + [None] * (m - 1)
    data: list = [(q - offset) / sq] + [None] * (m - 1)
    if v is not None:
        weights[1] = np.full(len(q), (sq / (sv * h)) ** 2)
        data[1] = v * h / sq
    mean = smoother.posterior(prior, 1.0, weights, data)[0][:, :3]
    return mean * sq / h ** np.arange(3) + np.array([offset, 0.0, 0.0])
