"""Whether a file's own time step is coarse: how much half of it changes what is predicted, over the
noise.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from adaptsim_jax.diagnosis.simulator import linearise
from adaptsim_jax.diagnosis.starts import taken_up, without
from adaptsim_jax.simulators.mujoco.criteria import REMARK

if TYPE_CHECKING:
    from adaptsim_jax.simulators.mujoco.diagnosed import MujocoSimulator


def halved(made: MujocoSimulator) -> MujocoSimulator:
    """The same stepped twice as often; each command acts as long as before."""
    model = made.made.model.__copy__()
    model.opt.timestep *= 0.5
    own = made.own
    twice = {k: np.repeat(getattr(own, k), 2, 1) for k in ("control", "past")}
    return replace(
        made, made=made.made.with_model(model), own=replace(own, at=2.0 * own.at, **twice)
    )


def change(made: MujocoSimulator, values: np.ndarray) -> float:
    """RMS change of predictions over the noise by half the step, with values [P], less what starts
    would take up. The median of a few stretches.
    """
    s = made.stretches
    which = np.unique(np.linspace(0, s.count - 1, REMARK.step_stretches).round().astype(int))
    rows, starts = np.tile(values, (len(which), 1)), s.start[which]
    noise = np.array([c.noise for c in made.channels])
    off = halved(made).predict(rows, starts, which) - made.predict(rows, starts, which)
    off = np.where(s.seen[which] > 0, np.nan_to_num(off / noise), 0.0).reshape(len(which), -1)
    by_start = linearise(made, rows, starts, which, np.zeros((0, len(values))))[0]
    left = without(taken_up(by_start), off[..., None])[..., 0]
    counts = (s.seen[which] > 0).reshape(len(which), -1).sum(1)
    return float(np.median(np.sqrt(np.square(left).sum(1) / np.maximum(counts, 1))))


def step_notes(made: MujocoSimulator, values: np.ndarray) -> list[str]:
    """One line where the step is coarse, none where it is fine enough."""
    size, step = change(made, values), 1e3 * float(made.made.model.opt.timestep)
    if size < REMARK.step_noises:
        return []
    return [
        f"The file's step of {step:g} ms is coarse for this log: half of it changes what is "
        f"predicted by {size:.2g} times the noise. What is named may be the step's; try a smaller "
        "timestep."
    ]
