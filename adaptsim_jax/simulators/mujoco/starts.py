"""Starts of stretches by least squares: damped steps of Gauss and Newton, each stretch by
itself.
"""

import numpy as np

from adaptsim_jax.simulators.mujoco.build import Stepped
from adaptsim_jax.simulators.mujoco.rollouts import (
    by_start,
    has_speeds,
    predict,
    residual,
    start_size,
)
from adaptsim_jax.simulators.mujoco.stretches import Stretches

ROUNDS = 6
GAINED = 1e-4  # share of its sum of squares that a round must take off a stretch for another
EXACT = 1e-18  # rad^2 (m^2) a reading: nothing is left to fit


def position_weight(made: Stepped, stretches: Stretches) -> np.ndarray:
    """[C'] one for angles and the base's pose, zero for speeds: a replay counts positions alone."""
    n = len(made.angle)
    speeds = np.zeros(n) if has_speeds(made, stretches) else np.zeros(0)
    return np.concatenate([np.ones(n), speeds, np.ones(6 if made.base >= 0 else 0)])


def fitted(
    made: Stepped,
    stretches: Stretches,
    weight: np.ndarray,
    rounds: int = ROUNDS,
    begin: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """(starts [W, 2 nv + na] from which the weighted squares are least, residual [W, L, C'] there).

    weight [C'] of each channel; begin: where the search begins (None: the measured starts). A start
    that the readings do not fix stays near there.
    """
    width, size = stretches.count, start_size(made)
    lanes = np.arange(width)
    starts, damping = (
        np.zeros((width, size)) if begin is None else begin.copy(),
        np.full(width, 1e-6),
    )
    off = residual(made, stretches, predict(made, stretches, starts, lanes), lanes)
    cost = _cost(off, weight)
    for other in _others(made, stretches) if begin is None else ():
        new = residual(made, stretches, predict(made, stretches, other, lanes), lanes)
        better = _cost(new, weight) < cost
        starts[better], off[better], cost[better] = (
            other[better],
            new[better],
            _cost(new, weight)[better],
        )
    open_ = np.flatnonzero(cost > EXACT * off[0].size)
    for _ in range(rounds):
        if not len(open_):
            break
        base, slope = by_start(made, stretches, starts[open_], open_)
        step = np.stack(
            [_step(r, j, weight, d) for r, j, d in zip(base, slope, damping[open_], strict=True)]
        )
        before = cost[open_].copy()
        length = np.ones(len(open_))
        pending = np.arange(len(open_))
        for _ in range(4):
            trial = starts[open_[pending]] + length[pending, None] * step[pending]
            new = residual(
                made, stretches, predict(made, stretches, trial, open_[pending]), open_[pending]
            )
            gain = _cost(new, weight)
            good = gain < cost[open_[pending]]
            took = open_[pending[good]]
            starts[took], off[took], cost[took] = trial[good], new[good], gain[good]
            pending = pending[~good]
            if not len(pending):
                break
            length[pending] *= 0.25
        damping[open_] = np.maximum(0.1 * damping[open_], 1e-9)
        damping[open_[pending]] *= 100.0
        fall = 1.0 - cost[open_] / np.maximum(before, 1e-300)
        open_ = open_[(fall > GAINED) & (cost[open_] > EXACT * off[0].size)]
    return starts, off


def _others(made: Stepped, stretches: Stretches) -> list[np.ndarray]:
    """Starts that may be nearer than smoothed speeds, which blur where a joint sticks: speeds by
    the rows just before, and rest.
    """
    nv = made.model.nv
    out = []
    for speed in (stretches.before, np.zeros_like(stretches.before)):
        start = np.zeros((stretches.count, start_size(made)))
        start[:, nv : 2 * nv] = speed - stretches.qvel
        out.append(start)
    return out


def _cost(off: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """[W]"""
    return np.square(off * weight).sum((1, 2))


def _step(off: np.ndarray, slope: np.ndarray, weight: np.ndarray, damping: float) -> np.ndarray:
    """Of one stretch's start. The derivative is of what is left (measured less predicted), so that
    the step is against it.
    """
    r = (off * weight).reshape(-1)
    j = (slope * weight[:, None]).reshape(len(r), -1)
    hess = j.T @ j
    size = np.sqrt(np.maximum(np.diagonal(hess), 1e-12))
    scaled = hess / size / size[:, None]
    scaled[np.diag_indices_from(scaled)] += damping + 1e-10
    return -np.linalg.solve(scaled + 1e-9 * np.eye(len(size)), (j.T @ r) / size) / size
