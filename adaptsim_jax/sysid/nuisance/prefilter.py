"""Angles that a symmetric filter has smoothed before they were written: the recording's doing, not the mechanism's.

A filter without lag (a moving average, a binomial, anything run there and back) returns `q + s q''` of a slow angle: `s` is half the
variance of its weights in time. With precise encoders that curvature is many times the noise, and no effect of a mechanism
makes it. So it is a nuisance: looked for about the declared model, and taken off the angles where it explains more than
any effect does.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from adaptsim_jax.effects.base import Effect
from adaptsim_jax.logs.noise.floor import NoiseFloor, noise_floor
from adaptsim_jax.logs.quality.findings import Audit
from adaptsim_jax.logs.types import Recording, Trial
from adaptsim_jax.sysid.criteria import Criteria
from adaptsim_jax.sysid.estimate import variance
from adaptsim_jax.sysid.estimate.candidate import compressed
from adaptsim_jax.sysid.estimate.fitted import Fit
from adaptsim_jax.sysid.estimate.problem import Problem
from adaptsim_jax.sysid.estimate.variance import Whitened
from adaptsim_jax.sysid.nuisance.null_model import fit_declared
from adaptsim_jax.sysid.score.scorer import Scorer
from adaptsim_jax.sysid.score.table import ScoreTable

ROUNDS = 4  # of putting back what a filter took; more would only raise noise


def fit_unfiltered(
    recording: Recording,
    checked: Audit,
    noise: NoiseFloor,
    effects: Sequence[Effect],
    known: float | None = None,
    criteria: Criteria = Criteria(),  # noqa: B008
) -> tuple[Problem, Fit, ScoreTable]:
    """`fit_declared`, of a recording whose angles a filter has smoothed without what it did to them. known: how far they are
    smoothed, `s` [s^2], 0 for not at all; looked for where None."""
    if known:
        recording = unsmoothed(recording, known)
        noise = noise_floor(recording, checked)
    found = fit_declared(recording, checked, noise, effects, criteria=criteria)
    if known is not None:
        return found
    s = smoothing_of(*found)
    if s is None:
        return found
    sharp = unsmoothed(recording, s)
    found = fit_declared(sharp, checked, noise_floor(sharp, checked), effects, criteria=criteria)
    more, gain = _extent(found[2], _whitened(*found))
    if gain < criteria.filter_worth or not 0.0 < s + more < 2.0 * s:
        return found
    sharp = unsmoothed(recording, s + more)
    return fit_declared(sharp, checked, noise_floor(sharp, checked), effects, criteria=criteria)


def smoothing_of(problem: Problem, base: Fit, first: ScoreTable) -> float | None:
    """How far the angles are smoothed, `s` [s^2]; None where that may be chance or an effect explains as much."""
    step = float(np.median([t.dt for t in problem.recording.trials]))
    white = _whitened(problem, base, first)
    gain, _ = Scorer(white, first.scorer.fold).gain([0])
    s, _ = _extent(first, white)
    if not 0.0 < s < problem.criteria.filter_widest * step**2 or float(chi2.sf(gain, 1)) > problem.criteria.filter_p:
        return None
    return s if gain > max((r.score.gain for r in first.ranked(base.active)), default=0.0) else None


def revised(problem: Problem, model: Fit, seen: ScoreTable) -> float | None:
    """What a model with named effects says of the filter: how far it smooths, if it shows only about that model; 0 if the one that
    was taken off was an effect's doing, so that the angles are now too sharp by all that was put into them; None if all is well."""
    taken = problem.recording.smoothing
    if not taken:
        return smoothing_of(problem, model, seen)
    more, gain = _extent(seen, _whitened(problem, model, seen))
    return 0.0 if gain > problem.criteria.filter_worth and more < -0.5 * taken else None


def _extent(first: ScoreTable, white: Whitened) -> tuple[float, float]:
    """How much smoother the angles are than the model's, `s` [s^2] of either sign, and its likelihood-ratio gain, both without
    the windows that begin with a trial: what filters do there is their own affair."""
    later = first.path.time[:, 0] > 0
    if np.any(later[first.lin.used.any(1)]):
        keep = lambda z: z * later.reshape(-1, *[1] * (z.ndim - 1))
        white = replace(white, **{k: keep(getattr(white, k)) for k in ("residual", "jac_theta", "atoms")})
    gain, amplitude = Scorer(white, first.scorer.fold).gain([0])
    return float(amplitude[0]), gain


def _whitened(problem: Problem, base: Fit, first: ScoreTable) -> Whitened:
    """The residual about a model and the curvature of its motion, the only atom, whitened alike."""
    lin = replace(first.lin, atoms=_curvature(problem, first))
    return variance.whiten(lin, variance.whitener(first.lin, base.parts, first.response.kernels))


def _curvature(problem: Problem, first: ScoreTable) -> np.ndarray:
    """Acceleration of the fitted motion in the rows of the residual, `[W, M, 1]` weighted as they are."""
    windows, path = problem.windows, first.path
    n = problem.plant.joint_dim
    time, v = path.time, path.x[:, :, n:]
    before, after = np.r_[0, np.arange(time.shape[1] - 1)], np.r_[np.arange(1, time.shape[1]), time.shape[1] - 1]
    span = (time[:, after] - time[:, before])[..., None]
    accel = np.where(span > 0, (v[:, after] - v[:, before]) / np.where(span > 0, span, 1.0), 0.0)
    accel = np.where((time > 0)[..., None], accel, 0.0)  # a filter leaves the first row alone
    rows = (accel[:, :, : windows.measured.shape[2]] * np.asarray(windows.weight)).reshape(len(time), -1)
    none = np.zeros((*rows.shape, 0))
    raw = replace(
        first.lin, residual=rows, jac_state=none, jac_theta=none, atoms=rows[..., None], impulse=none[:, :, None, :],
        used=np.asarray(windows.weight).reshape(rows.shape) > 0,
    )  # fmt: skip
    return compressed(problem, raw).atoms


def unsmoothed(recording: Recording, s: float) -> Recording:
    """The recording with the curvature of a smoothing `s` [s^2] taken off its angles, but for the ends of its trials."""
    return recording.replace(trials=tuple(_unsmoothed(t, s) for t in recording.trials), smoothing=s)


def told(recording: Recording) -> str:
    """What was taken off the recording's angles, in words."""
    width = 1e3 * np.sqrt(2.0 * recording.smoothing)
    return (
        f"the angles look smoothed by a filter without lag, {width:.2g} ms wide (rms): its curvature was taken off them"
    )


def _unsmoothed(trial: Trial, s: float) -> Trial:
    """Van Cittert's iteration: what the filter would take off the angles found so far is put back onto those written."""
    q = trial.q
    for _ in range(ROUNDS):
        q = trial.q - s * _bend(trial.time, q, max(1, int(np.ceil(2.5 * np.sqrt(s) / trial.dt - 0.5))))
    return replace(trial, q=q)


def _bend(time: np.ndarray, q: np.ndarray, k: int) -> np.ndarray:
    """Second derivative of the angles `[T, n]` rad/s^2 by differences over `k` rows, which hardly adds noise; zero at the ends."""
    bend = np.zeros_like(q)
    slope = (q[k:] - q[:-k]) / (time[k:] - time[:-k])[:, None]
    bend[k:-k] = 2.0 * (slope[k:] - slope[:-k]) / (time[2 * k :] - time[: -2 * k])[:, None]
    return bend
