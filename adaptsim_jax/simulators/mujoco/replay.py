"""The yardstick by MuJoCo itself: a model file over a recording, at the file's own step, from
starts fitted to each stretch.
"""

from dataclasses import dataclass

import numpy as np

from adaptsim_jax.logs.log import Log
from adaptsim_jax.mechanisms.spec import Source
from adaptsim_jax.simulators.mujoco.build import Stepped, stepped
from adaptsim_jax.simulators.mujoco.rollouts import start_size
from adaptsim_jax.simulators.mujoco.starts import fitted, position_weight
from adaptsim_jax.simulators.mujoco.stretches import MujocoStretches, cut

REPLAY_STEPS = 6e6  # steps of one linearisation of all starts: bounds its time and memory
MIN_STRETCHES = 8  # stretches, whatever they cost: a median needs some


@dataclass(frozen=True)
class Replayed:
    """error [W, n] rad or m by stretch and joint; measured and simulated angles, seen [W, L, n];
    base [W, 2] m and rad of a free base, None where none was logged; time [W, L] s; trial [W];
    stretches in all, of which these are `count`; span: s of a stretch.
    """

    made: Stepped
    stretches: MujocoStretches
    error: np.ndarray
    base: np.ndarray | None
    simulated: np.ndarray
    total: int
    span: float


def replayed(source: Source, log: Log, horizon: float, most: int | None = None) -> Replayed:
    """A model over a recording. horizon: s, 0 for each trial in one go; most: stretches, None: as
    many as `REPLAY_STEPS` allows.

    Raises BadInput as `build` and `stretches` do.
    """
    made = stepped(source, log)
    spans = [t.span for t in log.trials]
    span = min(horizon or 0.98 * min(spans), max(spans))
    total = sum(int(s / span + 1e-6) for s in spans)
    cost = (1 + start_size(made)) * span / float(made.model.opt.timestep)
    stretches = cut(made, log, span, most or max(MIN_STRETCHES, int(REPLAY_STEPS / cost)))
    weight = position_weight(made, stretches)
    _, off = fitted(made, stretches, weight)
    n = len(made.angle)
    mask = stretches.seen[..., :n]
    error = np.sqrt(np.square(off[..., :n]).sum(1) / np.maximum(mask.sum(1), 1))
    base = None
    if made.base >= 0:
        mean = np.square(off[..., -6:]).reshape(*off.shape[:2], 2, 3).sum(-1).mean(1)
        base = np.sqrt(mean)
    return Replayed(
        made, stretches, error, base, stretches.measured[..., :n] - off[..., :n], total, span
    )
