"""A trial of a real pendulum as the trajectory that the task's observation and return are made of."""

from collections.abc import Mapping
from typing import Literal

import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.mechanisms.double_pendulum.linear import HORIZON, LATE_SNAPSHOTS, SAMPLES, SNAPSHOTS
from adaptsim_jax.tasks.pendulum.task import PendulumTrajectory

NEEDED = ("time", "q1", "q2", "tau1", "tau2")
COLUMNS = (*NEEDED, "v1", "v2")


def measured_trajectory(
    columns: Mapping[str, np.ndarray], where: str, observation: Literal["full", "late"] = "full"
) -> PendulumTrajectory:
    """The trajectory of a trial measured from the moment that the policy was let go, hanging straight down.

    `columns` of `[T]`: `time` s, `q1`, `q2` rad with zero upright, `tau1`, `tau2` N m (each held to the next
    row), and optionally `v1`, `v2` rad/s, else differences of the angles. It must last the task's 2.5 s; the
    cost is the task's sum over 1000 samples, of angles and velocities interpolated. Raises BadInput that
    names `where`.
    """
    missing = [name for name in NEEDED if name not in columns]
    if missing:
        raise BadInput(f"{where}: column '{missing[0]}' is missing; needed are {', '.join(NEEDED)}")
    time = np.asarray(columns["time"], float) - columns["time"][0]
    if not np.all(np.diff(time) > 0):
        raise BadInput(f"{where}: time does not increase; sort the rows and remove doubles")
    step = float(np.median(np.diff(time)))
    if time[-1] < HORIZON - 1.5 * step:
        raise BadInput(f"{where}: lasts {time[-1]:.3g} s; run the policy for {HORIZON} s")
    grid = np.linspace(0.0, HORIZON, SAMPLES)
    angles = np.stack([np.interp(grid, time, columns[name]) for name in ("q1", "q2")], 1)
    _check_start(angles[0], where)
    velocities = _velocities(columns, time, grid)
    held = np.clip(np.searchsorted(time, grid, side="right") - 1, 0, len(time) - 1)
    torques = np.stack([np.asarray(columns[name])[held] for name in ("tau1", "tau2")], 1)
    cost = sum(float(np.sum(np.square(x))) for x in (angles, velocities, torques))
    indices = SNAPSHOTS if observation == "full" else LATE_SNAPSHOTS
    points = jnp.asarray(angles[np.asarray(indices)], jnp.float32)
    return PendulumTrajectory(points, jnp.float32(cost), jnp.zeros((), jnp.int32))


def _velocities(columns: Mapping[str, np.ndarray], time: np.ndarray, grid: np.ndarray) -> np.ndarray:
    if "v1" in columns and "v2" in columns:
        return np.stack([np.interp(grid, time, columns[name]) for name in ("v1", "v2")], 1)
    rates = [np.gradient(np.asarray(columns[name], float), time) for name in ("q1", "q2")]
    return np.stack([np.interp(grid, time, rate) for rate in rates], 1)


def _check_start(first: np.ndarray, where: str) -> None:
    # The task starts at q1 = -pi. A start elsewhere is another task, and most often another zero of the
    # angle.
    if np.max(np.abs(first - [-np.pi, 0.0])) > 0.5:
        raise BadInput(
            f"{where}: starts at q1 = {first[0]:.3g}, q2 = {first[1]:.3g} rad; the task starts hanging, "
            f"at q1 = -3.14, q2 = 0 with zero upright: mend the zero of the angles, their unit, or the start"
        )
