"""The yardstick by MuJoCo itself: a model file over a recording, at the file's own step, from
starts fitted to each stretch.
"""

from dataclasses import dataclass

import numpy as np

from adaptsim_jax.logs.log import Log
from adaptsim_jax.mechanisms.spec import Source
from adaptsim_jax.simulators.mujoco.build import SteppedModel, make_stepped_model
from adaptsim_jax.simulators.mujoco.rollouts import start_size
from adaptsim_jax.simulators.mujoco.starts import fit_stretch_starts, position_weight
from adaptsim_jax.simulators.mujoco.stretches import MujocoStretches, cut_stretches

REPLAY_STEPS = 6e6  # steps of one linearisation of all starts: bounds its time and memory
MIN_STRETCHES = 8  # stretches, whatever they cost: a median needs some


@dataclass(frozen=True)
class Replayed:
    """error [W, n] rad or m by stretch and joint; measured and simulated angles, seen [W, L, n];
    base [W, 2] m and rad of a free base, None where none was logged; time [W, L] s; trial [W];
    stretches in all, of which these are `count`; span: s of a stretch.
    """

    stepped_model: SteppedModel
    stretches: MujocoStretches
    error: np.ndarray
    base: np.ndarray | None
    simulated: np.ndarray
    total: int
    span: float


def replayed(
    source: Source, log: Log, horizon: float, max_stretches: int | None = None
) -> Replayed:
    """A model over a recording. horizon: s, 0 for each trial in one go; most: stretches, None: as
    many as `REPLAY_STEPS` allows.

    Raises BadInput as `build` and `stretches` do.
    """
    stepped_model = make_stepped_model(source, log)
    spans = [t.span for t in log.trials]
    span = min(horizon or 0.98 * min(spans), max(spans))
    total = sum(int(s / span + 1e-6) for s in spans)
    cost = (1 + start_size(stepped_model)) * span / float(stepped_model.model.opt.timestep)
    stretches = cut_stretches(
        stepped_model, log, span, max_stretches or max(MIN_STRETCHES, int(REPLAY_STEPS / cost))
    )
    weight = position_weight(stepped_model, stretches)
    _, residuals = fit_stretch_starts(stepped_model, stretches, weight)
    n = len(stepped_model.angle)
    is_measured = stretches.is_measured[..., :n]
    error = np.sqrt(np.square(residuals[..., :n]).sum(1) / np.maximum(is_measured.sum(1), 1))
    base = None
    if stepped_model.base >= 0:
        mean = np.square(residuals[..., -6:]).reshape(*residuals.shape[:2], 2, 3).sum(-1).mean(1)
        base = np.sqrt(mean)
    return Replayed(
        stepped_model,
        stretches,
        error,
        base,
        stretches.measured[..., :n] - residuals[..., :n],
        total,
        span,
    )
