"""Starts of stretches by least squares: damped steps of Gauss and Newton, each stretch by
itself.
"""

import numpy as np

from adaptsim_jax.diagnosis.steps import best_of, bounded_step, fit_starts
from adaptsim_jax.simulators.mujoco.build import SteppedModel
from adaptsim_jax.simulators.mujoco.rollouts import (
    by_start,
    has_speeds,
    predict,
    residual,
    start_size,
)
from adaptsim_jax.simulators.mujoco.stretches import MujocoStretches

MAX_START_ROUNDS = 6  # rounds of a start's fit: bounds its time
START_DAMPING = 1e-6  # share of the diagonal; a start that the readings do not fix stays near
LENGTHS = 0.25 ** np.arange(4.0)  # of a step, tried in turn
EXACT_START_SQUARE = 1e-18  # rad^2 (m^2) a reading: nothing is left to fit


def position_weight(stepped_model: SteppedModel, stretches: MujocoStretches) -> np.ndarray:
    """[C'] one for angles and the base's pose, zero for speeds and sensors: a replay counts
    positions alone.
    """
    n = len(stepped_model.angle)
    others = np.zeros(n * has_speeds(stepped_model, stretches) + len(stepped_model.sensors))
    return np.concatenate([np.ones(n), others, np.ones(6 if stepped_model.base >= 0 else 0)])


def fit_stretch_starts(
    stepped_model: SteppedModel,
    stretches: MujocoStretches,
    weight: np.ndarray,
    rounds: int = MAX_START_ROUNDS,
) -> tuple[np.ndarray, np.ndarray]:
    """(starts [W, 2 nv + na] from which the weighted squares are least, residual [W, L, C'] there).

    weight [C'] of each channel. A start that the readings do not fix stays near the measured one.
    """

    def evaluate(starts: np.ndarray, lanes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        off = residual(
            stepped_model, stretches, predict(stepped_model, stretches, starts, lanes), lanes
        )
        return off, np.square(off * weight).sum((1, 2))

    def propose(starts: np.ndarray, off: np.ndarray, lanes: np.ndarray) -> np.ndarray:
        _, slope = by_start(stepped_model, stretches, starts, lanes)
        step = np.stack([_step(r, j, weight) for r, j in zip(off, slope, strict=True)])
        return starts + LENGTHS[:, None, None] * step

    zero = np.zeros((stretches.count, start_size(stepped_model)))
    best = best_of((zero, *_other_starts(stepped_model, stretches)), evaluate)
    readings = best.left[0].size
    unfinished = np.flatnonzero(best.loss > EXACT_START_SQUARE * readings)
    fit = fit_starts(best, propose, evaluate, rounds, lanes=unfinished)
    return fit.starts, fit.left


def _other_starts(stepped_model: SteppedModel, stretches: MujocoStretches) -> list[np.ndarray]:
    """Starts that may be nearer than smoothed speeds, which blur where a joint sticks: speeds by
    the rows just before, and rest.
    """
    nv = stepped_model.model.nv
    out = []
    for speed in (stretches.speed_before, np.zeros_like(stretches.speed_before)):
        start = np.zeros((stretches.count, start_size(stepped_model)))
        start[:, nv : 2 * nv] = speed - stretches.qvel
        out.append(start)
    return out


def _step(off: np.ndarray, slope: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Step [S] of one stretch's start.

    The derivative is of what is left (measured less predicted), so that a step is against it.
    """
    r = (off * weight).reshape(-1)
    j = (slope * weight[:, None]).reshape(len(r), -1)
    free = np.full(j.shape[1], np.inf)
    return bounded_step(j.T @ j, -(j.T @ r), -free, free, START_DAMPING)
