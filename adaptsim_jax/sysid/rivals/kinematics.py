"""Whether a wrong length of the first link would explain what no effect does.

The declared parameters of a rigid pendulum absorb every error of its geometry but one: `l1` also turns the second link's
moment about its joint into the coupling of both (`double_pendulum.rigid.base_mass_matrix`). A tape measure that is off by half a
percent leaves structure that precise encoders see, and that is nobody's effect.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from adaptsim_jax.core.parallel import parallel_map
from adaptsim_jax.effects.base import Effect
from adaptsim_jax.logs.segments import folds
from adaptsim_jax.sysid.estimate import variance
from adaptsim_jax.sysid.estimate.candidate import Candidate, compressed, linearised
from adaptsim_jax.sysid.estimate.fitted import Fit, force_ratio
from adaptsim_jax.sysid.estimate.problem import Diverged, Problem, at_point, prepare_within_reach
from adaptsim_jax.sysid.nuisance.null_model import declared_base
from adaptsim_jax.sysid.score.scorer import Scorer
from adaptsim_jax.sysid.score.table import ScoreTable

STEP = 0.01  # of the length: how far apart the fits are that show where the likelihood is largest
FINE = 0.001  # the same close to it
FARTHEST = 0.15  # of the length: beyond this nobody measured it
ROUNDS = 4
SMALL = 1e-3  # of the length: the change by which its effect on the outputs is told


class Remeasured(NamedTuple):
    """The declared model with another `l1` [m], and the share of the unexplained force that it leaves."""

    l1: float
    model: Fit
    left: float


def remeasured(
    problem: Problem, base: Fit, effects: Sequence[Effect], first: ScoreTable | None = None
) -> Remeasured | None:
    """The likeliest `l1`, by parabolas through the likelihoods of declared fits and through their unexplained force; None where no
    fit is to be had, where the first two show that none will leave as little of that force as counts as explained, where already
    the linear score about the declared model (`first`) says so, for a model whose geometry its parameters absorb, or for a mended
    model, which is of one geometry."""
    recording, criteria = problem.recording, problem.criteria
    if recording.model != "rigid_body" or "l1" not in recording.geometry or recording.model_file is not None:
        return None
    if first is not None and _faint(problem, base, first):
        return None
    fits = {0.0: base}

    def total(offset: float) -> float:
        if offset not in fits:
            fits[offset] = _with_length(problem, effects, recording.geometry["l1"] * (1.0 + offset))
        return fits[offset].total

    def forces(centre: float, step: float) -> list[float]:
        """Variance of the unexplained force about an offset."""
        offsets = (centre - step, centre, centre + step)
        parallel_map(total, offsets)
        return [fits[offset].moving.sum() for offset in offsets]

    try:
        seen = forces(0.0, STEP)
        if _foretold(seen) > criteria.length_doubt * criteria.explained:
            return None
        offset = _likeliest(
            total, lambda offset: force_ratio(fits[offset], base) > criteria.length_doubt * criteria.explained
        )
    except Diverged:
        return None
    near = STEP * _vertex(seen)
    with suppress(Diverged):  # a length far off, at which there is no fit: the likeliest so far stands
        closer = near + FINE * _vertex(forces(near, FINE))
        offset = max((offset, near, float(np.clip(closer, -FARTHEST, FARTHEST))), key=total)
    return Remeasured(recording.geometry["l1"] * (1.0 + offset), fits[offset], force_ratio(fits[offset], base))


def _with_length(problem: Problem, effects: Sequence[Effect], l1: float) -> Fit:
    """The declared model fitted with another `l1` [m], in the same steps."""
    changed = problem.recording.replace(geometry=problem.recording.geometry | {"l1": l1})
    other, start = prepare_within_reach(changed, problem.audit, problem.noise, effects, criteria=problem.criteria)
    other = replace(other, windows=replace(other.windows, substeps=problem.windows.substeps))
    return declared_base(other, start)


def _faint(problem: Problem, base: Fit, first: ScoreTable) -> bool:
    """Whether another length explains far less than the best candidate does, to the first order."""
    ranked, column = first.ranked(), _outputs_by_length(problem, base.candidate)
    if not ranked or not np.all(np.isfinite(column)):
        return False
    factor = variance.whitener(first.lin, base.parts, first.response.kernels)
    white = variance.whiten(replace(first.lin, atoms=column[..., None]), factor)
    gain, _ = Scorer(white, folds(white.trial, white.rows)).gain([0])
    return gain < problem.criteria.length_faint * ranked[0].score.gain


def _outputs_by_length(problem: Problem, model: Candidate) -> np.ndarray:
    """How the outputs change with the length `[W, M]`, standard deviations for each 1 of it, by a central difference."""

    def residual(scale: float) -> np.ndarray:
        constants = {**problem.plant.constants, "l1": problem.plant.constants["l1"] * scale}
        plant = replace(problem.plant, constants=constants)
        other = replace(problem, plant=plant, model=replace(problem.model, plant=plant))
        fit = at_point(other, model.active, model.theta, model.eff, model.refit.point.x0)
        return compressed(problem, linearised(problem, fit)).residual

    with np.errstate(invalid="ignore"):  # a model that runs away
        return (residual(1.0 - SMALL) - residual(1.0 + SMALL)) / (2.0 * SMALL)


def _foretold(force: Sequence[float]) -> float:
    """The least share of the unexplained force that any length within `FARTHEST` would leave, by the parabola (the line, where that
    bends down) through its variance at lengths one step apart."""
    low, middle, high = force
    bend, slope, best = max(low + high - 2.0 * middle, 0.0), 0.5 * (high - low), _vertex(force)
    return float(np.sqrt(max(1.0 + (slope * best + 0.5 * bend * best**2) / max(middle, 1e-300), 0.0)))


def _vertex(force: Sequence[float]) -> float:
    """Steps from the middle to where the parabola through variances a step apart is lowest (its slope leads, where that bends down),
    within `FARTHEST`. Sensors that are good to a thousandth of the length make likelihoods no parabola over a hundredth of it."""
    low, middle, high = force
    bend, slope, most = low + high - 2.0 * middle, 0.5 * (high - low), FARTHEST / STEP
    return float(np.clip(-slope / bend, -most, most)) if bend > 0 else -most * float(np.sign(slope))


def _likeliest(total, far: Callable[[float], bool] = lambda offset: False) -> float:
    """The offset [1] with the largest total that a few parabolas lead to, within `FARTHEST`.

    far: whether an offset leaves so much that it is not near the right one. What is left falls in proportion on the way there, so
    where a likeliest one is far and a step on from it is no likelier, there is none, and no more are tried."""
    centre, step = 0.0, STEP
    for _ in range(ROUNDS):
        low, middle, high = parallel_map(total, (centre - step, centre, centre + step))
        bend, slope = low + high - 2.0 * middle, 0.5 * (high - low)
        leap = np.clip(-slope / bend, -3.0, 3.0) if bend < 0 else 3.0 * np.sign(slope)
        tried = float(np.clip(centre + leap * step, -FARTHEST, FARTHEST))
        best = max((centre - step, centre, centre + step, tried), key=total)
        if abs(leap) <= 1.0 or (best != tried and far(best)):
            return best
        centre = best
    return centre
