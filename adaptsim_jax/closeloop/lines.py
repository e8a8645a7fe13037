"""Lines in the spectrum of the unexplained force: a hum, a rotor out of balance, a belt. Nothing in the motion predicts them in
another trial, where their phase differs, but chance has no lines.

The force that a recording asks for is compared, frequency by frequency and joint by joint, with what is asked for at the
frequencies beside it. Phases are free in each stretch of a few seconds, so that a frequency may wander a little.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from adaptsim_jax.closeloop import disturbance
from adaptsim_jax.closeloop.problem import Problem
from adaptsim_jax.closeloop.view import View

HIGHEST = 25.0  # Hz
STRETCH = 6.0  # s of a trial in which a phase is kept
BESIDE = 10  # frequencies to each side that a line is compared with, but for the next one
LEAST_STRETCHES = 3  # fewer tell a line from the shape of one motion badly
NO_CHANCE = 1e-8  # p-value below which it is a line
LEAST_SHARE = 0.01


@dataclass(frozen=True)
class Line:
    """The sharpest line: `joint` it acts at, frequency [Hz], its share of the whitened sum of squares beyond what is beside it,
    and the p-value of a line as high, corrected for all frequencies and joints."""

    joint: str
    frequency: float
    share: float
    p_value: float

    def words(self) -> str:
        return f"line at {self.frequency:.3g} Hz"


def line(problem: Problem, view: View, parts: disturbance.Components) -> Line | None:
    """The sharpest line about a model with residual covariance `parts`, where it is no chance; None where there is none, or
    where the recording is too short to say."""
    lin, time = view.lin, view.path.time[:, :-1]
    live = view.path.dt > 0
    stretch = _stretches(lin.trial, time, lin.used.any(1))
    spans = [np.ptp(time[stretch == s][live[stretch == s]]) for s in np.unique(stretch[stretch >= 0])]
    spacing = float(np.median(view.path.dt[live]))
    if len(spans) < LEAST_STRETCHES:
        return None
    frequency = np.arange(2, min(HIGHEST, 0.2 / spacing) * np.median(spans)) / np.median(spans)
    if len(frequency) <= 2 * BESIDE:
        return None
    tones = _tones(lin, time, live, frequency)
    white = disturbance.whiten(replace(lin, atoms=tones), disturbance.whitener(lin, parts, view.response.kernels))
    columns = white.atoms.reshape(*white.atoms.shape[:2], -1, 2)
    gain = sum(_gain(columns[stretch == s], view.scorer.residual[stretch == s]) for s in range(len(spans)))
    gain = gain.reshape(lin.impulse.shape[2], len(frequency))
    freedom = 2 * len(spans)
    beside = _beside(gain) / chi2.median(freedom)
    p = np.minimum(1.0, chi2.sf(gain / np.maximum(beside, 1.0), freedom) * gain.size)
    joint, at = np.unravel_index(np.argmin(p - 1e-12 * gain / gain.max()), p.shape)
    share = max(float(gain[joint, at] - beside[joint, at] * freedom), 0.0) / view.scorer.sum_squares
    found = Line(problem.plant.joints[joint], float(frequency[at]), share, float(p[joint, at]))
    return found if found.p_value < NO_CHANCE and found.share > LEAST_SHARE else None


def _stretches(trial: np.ndarray, time: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Number of the stretch of each window `[W]`, whole trials where they are short; -1 where there is nothing."""
    out, count = np.full(len(trial), -1), 0
    for name in np.unique(trial[used]):
        here = np.flatnonzero((trial == name) & used)
        pieces = max(1, round(float(time[here].max() - time[here].min()) / STRETCH))
        for part in np.array_split(here[np.argsort(time[here, 0])], min(pieces, len(here))):
            out[part], count = count, count + 1
    return out


def _tones(lin: disturbance.Linearised, time: np.ndarray, live: np.ndarray, frequency: np.ndarray) -> np.ndarray:
    """Output change `[W, M, n F 2]` of a unit cosine and sine at each joint and frequency."""
    angle = 2.0 * np.pi * frequency[:, None, None] * time
    force = np.stack([np.cos(angle), np.sin(angle)], 1) * live  # [F, 2, W, L]
    flat = force.reshape(-1, *time.shape).transpose(1, 2, 0).astype(np.float32)
    each = [lin.impulse[:, :, j].astype(np.float32) @ flat for j in range(lin.impulse.shape[2])]
    return np.concatenate(each, -1)


def _gain(columns: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Fall of a stretch's sum of squares `[n F]` with a tone of its own amplitude and phase; columns `[W, M, n F, 2]`."""
    normal = np.einsum("wmki,wmkj->kij", columns, columns, optimize=True)
    slope = np.einsum("wmki,wm->ki", columns, residual, optimize=True)
    normal = normal + (1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] + 1e-12) * np.eye(2)
    return np.einsum("ki,ki->k", slope, np.linalg.solve(normal, slope[..., None])[..., 0])


def _beside(gain: np.ndarray) -> np.ndarray:
    """Median over the neighbours of each frequency, itself and the next ones left out; `[n, F]` both."""
    apart = np.abs(np.arange(gain.shape[1])[:, None] - np.arange(gain.shape[1]))
    near = (apart > 1) & (apart <= BESIDE)
    return np.stack([np.median(gain[:, n], axis=1) for n in near], 1)
