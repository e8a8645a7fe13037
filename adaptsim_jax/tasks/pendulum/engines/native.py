"""The double pendulum by `mujoco.rollout`, on all cores."""

from __future__ import annotations

import importlib
import os
from typing import Any

import numpy as np

from adaptsim_jax.tasks.engine import EngineKind, NoSettings
from adaptsim_jax.tasks.pendulum.engines import scene
from adaptsim_jax.tasks.pendulum.engines.scene import finished


def make_native(dt: float):
    mujoco: Any = importlib.import_module("mujoco")
    rollout: Any = importlib.import_module("mujoco.rollout")

    def simulate(params, commands, initial):
        models = [scene.model(p, dt) for p in np.asarray(params)]
        threads = min(os.cpu_count() or 1, len(models))
        data = [mujoco.MjData(models[0]) for _ in range(threads)]
        start = np.concatenate([np.zeros((len(models), 1)), np.asarray(initial)], axis=1)
        state, _ = rollout.rollout(models, data, start, control=np.asarray(commands, float))
        return finished(state[:, :, 1:5])

    return simulate


ENGINE = EngineKind(NoSettings, make_native)
