"""Torque over volts or amperes of drives, from what their motion takes."""

import numpy as np

from adaptsim_jax.attribution.criteria import SERVO
from adaptsim_jax.attribution.equation.balance import Balance, rms
from adaptsim_jax.attribution.parameters import Vector
from adaptsim_jax.attribution.problem import TreeProblem, values_of
from adaptsim_jax.diagnosis.criteria import FOLD
from adaptsim_jax.diagnosis.folds import folds_of
from adaptsim_jax.diagnosis.testing import jackknife


def drive_gains(problem: TreeProblem, balance: Balance) -> dict[int, float | None]:
    """Torque over volts or amperes of the driven joints of a group, from told = (forces that the
    motion takes, by the file's bodies) / gain
    + friction and rotor over it; None where these do not give the scale.
    """
    values = values_of(problem, balance.group, Vector((), np.zeros(0)))
    takes = balance.regressor @ values.inertial[..., 0].ravel()
    takes = takes + np.asarray(balance.group.model.tree.armature) * balance.acceleration
    averaged, speed, sign = (
        balance.averaged(balance.u),
        balance.averaged(balance.v),
        balance.averaged(balance.sign),
    )
    out: dict[int, float | None] = {}
    for k, j in enumerate(balance.group.joints):
        if not np.any(averaged[:, k]):
            continue
        columns = np.stack(
            [
                takes[:, k],
                speed[:, k],
                sign[:, k],
                balance.acceleration[:, k],
                np.ones(len(averaged)),
            ],
            1,
        )
        x, spread = _regressed(balance, averaged[:, k], columns, balance.clear[:, k])
        out[int(j)] = 1.0 / x[0] if x[0] > SERVO.drive_significant * spread[0] else None
    return out


def _regressed(balance: Balance, y: np.ndarray, columns: np.ndarray, clear: np.ndarray):
    """Coefficients, and their standard errors by a jackknife over folds."""
    weight = np.sqrt(clear)
    fold = folds_of(balance.trial, FOLD.min_windows)
    size = rms(columns) + 1e-300

    def solve(some):
        return (
            np.linalg.lstsq(
                (columns / size * weight[:, None])[some], (y * weight)[some], rcond=1e-6
            )[0]
            / size
        )

    whole = solve(np.ones(len(y), bool))
    each = np.array([solve(fold != f) for f in np.unique(fold)])
    return whole, np.maximum(jackknife(each), 1e-300)
