"""Lines in the spectrum of the unexplained force: a hum, a rotor out of balance, a belt. Nothing in the motion predicts them in
another trial, where their phase differs, but chance has no lines.

The force that a recording asks for is compared, frequency by frequency and joint by joint, with what is asked for at the
frequencies beside it: once over all trials, with a phase of its own in each stretch of a few seconds; once in short stretches,
each at a frequency of its own, for a hum that wanders; and once a band with the octaves beside it, for what rings (a base on a soft
clamp): its phase is lost within a stretch, but not its frequency.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from adaptsim_jax.sysid.criteria import Criteria
from adaptsim_jax.sysid.estimate import variance
from adaptsim_jax.sysid.estimate.problem import Problem
from adaptsim_jax.sysid.score.table import ScoreTable

HIGHEST = 25.0  # Hz
STRETCH, SHORT = 6.0, 2.0  # s of a trial in which a phase is kept
BESIDE = 10  # frequencies to each side that a line is compared with, but for the next one
NARROW, AROUND = 0.1, 0.3  # of its frequency: half the width of a resonance, and where what it is compared with begins


@dataclass(frozen=True)
class Line:
    """The sharpest line: `joint` it acts at, frequency [Hz], its share of the whitened sum of squares beyond what is beside it,
    and the p-value of a line as high, corrected for all frequencies and joints. highest [Hz]: where it wanders, as far as this;
    broad: it is no line but a resonance, which the motion rings."""

    joint: str
    frequency: float
    share: float
    p_value: float
    highest: float | None = None
    broad: bool = False

    def words(self) -> str:
        if self.broad:
            return f"resonance at {self.frequency:.2g} Hz"
        if self.highest is None:
            return f"line at {self.frequency:.3g} Hz"
        return f"hum that wanders between {self.frequency:.2g} and {self.highest:.2g} Hz"


def line(problem: Problem, view: ScoreTable, parts: variance.VarianceComponents) -> Line | None:
    """The sharpest line about a model with residual covariance `parts`, where it is no chance; None where there is none, or
    where the recording is too short to say. Of a hum that wanders and a resonance, whichever accounts for more."""
    frequency, gain = _gains(view, parts, STRETCH)
    long = len(frequency) > 2 * BESIDE and len(gain) >= problem.criteria.line_stretches
    if long and (steady := _sure([_steady(problem, view, frequency, gain)], problem.criteria)) is not None:
        return steady
    return _sure(
        [_wandering(problem, view, parts), _resonance(problem, view, frequency, gain) if long else None],
        problem.criteria,
    )


def _sure(found: list[Line | None], criteria: Criteria) -> Line | None:
    """The one that accounts for most of those that are no chance."""
    sure = [one for one in found if one is not None and one.p_value < criteria.sure_p and one.share > criteria.follows]
    return max(sure, key=lambda one: one.share, default=None)


def _steady(problem: Problem, view: ScoreTable, frequency: np.ndarray, gain: np.ndarray) -> Line:
    """At one frequency in all trials."""
    freedom, total = 2 * len(gain), gain.sum(0)
    beside = _beside(total) / chi2.median(freedom)
    p = np.minimum(1.0, chi2.sf(total / np.maximum(beside, 1.0), freedom) * total.size)
    joint, at = np.unravel_index(np.argmin(p - 1e-12 * total / total.max()), p.shape)
    share = max(float(total[joint, at] - beside[joint, at] * freedom), 0.0) / view.scorer.sum_squares
    return Line(problem.plant.joints[joint], float(frequency[at]), share, float(p[joint, at]))


def _resonance(problem: Problem, view: ScoreTable, frequency: np.ndarray, gain: np.ndarray) -> Line | None:
    """A narrow band that stands out of the octaves beside it, in one stretch as in others (Fisher's sum, no stretch more than sure).
    One high frequency does not make a band."""
    found = []
    for centre in frequency:
        apart = np.abs(frequency - centre)
        band = apart <= max(NARROW * centre, 1.5 * (frequency[1] - frequency[0]))
        beside = (apart > AROUND * centre) & (frequency > 0.5 * centre) & (frequency < 2.0 * centre)
        if band.sum() < 3 or beside.sum() < BESIDE:
            continue
        level = np.maximum(np.median(gain[..., beside].mean(0), axis=1) / 2.0, 1.0)  # a chi-square of two degrees
        lower, freedom = np.sort(gain[..., band], axis=2)[..., :-1].sum(2) / level, 2 * (band.sum() - 1)
        p = np.clip(chi2.sf(lower, freedom), problem.criteria.stretch_p_of_band, 1.0)
        joined = np.minimum(chi2.sf(-2.0 * np.log(p).sum(0), 2 * len(gain)) * gain[0].size, 1.0)
        share = (gain[..., band].sum((0, 2)) - 2.0 * level * len(gain) * band.sum()) / view.scorer.sum_squares
        for j in np.flatnonzero(lower.mean(0) > problem.criteria.resonance_height * freedom):
            found.append(Line(problem.plant.joints[j], float(centre), float(share[j]), float(joined[j]), broad=True))
    return min(found, key=lambda one: (one.p_value, -one.share), default=None)


def _wandering(problem: Problem, view: ScoreTable, parts: variance.VarianceComponents) -> Line | None:
    """At another frequency in each short stretch; each brings the p-value of its highest (Fisher's sum), but no more than is sure."""
    frequency, gain = _gains(view, parts, SHORT)
    if len(frequency) <= 2 * BESIDE or len(gain) < 2 * problem.criteria.line_stretches:
        return None
    beside = np.maximum(_beside(gain.mean(0)) / 2.0, 1.0)  # [n, F]; the mean of a chi-square of two degrees is two
    top = gain / beside
    at = top.argmax(2)  # [S, n]
    highest = np.take_along_axis(top, at[..., None], 2)[..., 0]
    p = -np.expm1(len(frequency) * np.log1p(-chi2.sf(highest, 2)))
    joined = chi2.sf(-2.0 * np.log(np.clip(p, problem.criteria.stretch_p, 1.0)).sum(0), 2 * len(gain)) * len(p[0])
    excess = np.take_along_axis(gain - 2.0 * beside, at[..., None], 2)[..., 0].sum(0)
    joint = int(np.argmin(joined - 1e-12 * excess / np.abs(excess).max()))
    low, high = np.quantile(frequency[at[:, joint]], [0.1, 0.9])
    share = max(float(excess[joint]), 0.0) / view.scorer.sum_squares
    return Line(problem.plant.joints[joint], float(low), share, float(min(joined[joint], 1.0)), float(high))


def _gains(view: ScoreTable, parts: variance.VarianceComponents, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies `[F]` Hz and, in each stretch of about `seconds`, the fall of the whitened sum of squares `[S, n, F]` with a tone
    of its own amplitude and phase at each joint."""
    lin, time = view.lin, view.path.time[:, :-1]
    live = view.path.dt > 0
    stretch = _stretches(lin.trial, time, np.asarray(lin.used.any(1)), seconds)
    names = range(stretch.max() + 1)
    span = float(np.median([np.ptp(time[stretch == s][live[stretch == s]]) for s in names]))
    highest = min(HIGHEST, 0.2 / float(np.median(view.path.dt[live])))
    frequency = np.arange(2, highest * span) / max(span, 1e-9)
    tones = _tones(lin, time, live, frequency)
    white = variance.whiten(replace(lin, atoms=tones), variance.whitener(lin, parts, view.response.kernels))
    columns = white.atoms.reshape(*white.atoms.shape[:2], -1, 2)
    gain = [_gain(columns[stretch == s], view.scorer.residual[stretch == s]) for s in names]
    return frequency, np.stack(gain).reshape(len(names), lin.impulse.shape[2], len(frequency))


def _stretches(trial: np.ndarray, time: np.ndarray, used: np.ndarray, seconds: float) -> np.ndarray:
    """Number of the stretch of each window `[W]`, whole trials where they are short; -1 where there is nothing."""
    out, count = np.full(len(trial), -1), 0
    for name in np.unique(trial[used]):
        here = np.flatnonzero((trial == name) & used)
        pieces = max(1, round(float(time[here].max() - time[here].min()) / seconds))
        for part in np.array_split(here[np.argsort(time[here, 0])], min(pieces, len(here))):
            out[part], count = count, count + 1
    return out


def _tones(lin: variance.Linearised, time: np.ndarray, live: np.ndarray, frequency: np.ndarray) -> np.ndarray:
    """Output change `[W, M, n F 2]` of a unit cosine and sine at each joint and frequency."""
    angle = 2.0 * np.pi * frequency[:, None, None] * time
    force = np.stack([np.cos(angle), np.sin(angle)], 1) * live  # [F, 2, W, L]
    flat = force.reshape(-1, *time.shape).transpose(1, 2, 0).astype(np.float32)
    each = [lin.impulse[:, :, j].astype(np.float32) @ flat for j in range(lin.impulse.shape[2])]
    return np.concatenate(each, -1)


def _gain(columns: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Fall of a stretch's sum of squares `[n F]` with a tone; columns `[W, M, n F, 2]`."""
    normal = np.einsum("wmki,wmkj->kij", columns, columns, optimize=True)
    slope = np.einsum("wmki,wm->ki", columns, residual, optimize=True)
    normal = normal + (1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] + 1e-12) * np.eye(2)
    return np.einsum("ki,ki->k", slope, np.linalg.solve(normal, slope[..., None])[..., 0])


def _beside(gain: np.ndarray) -> np.ndarray:
    """Median over the neighbours of each frequency, itself and the next ones left out; `[n, F]` both."""
    apart = np.abs(np.arange(gain.shape[1])[:, None] - np.arange(gain.shape[1]))
    near = (apart > 1) & (apart <= BESIDE)
    return np.stack([np.median(gain[:, n], axis=1) for n in near], 1)
