"""Scooping in native MuJoCo on all cores: the sphere cloud of the shipped scene, float64."""

from __future__ import annotations

import copy
import importlib
import os
import threading
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from adaptsim_jax.tasks.engine import EngineKind
from adaptsim_jax.tasks.scooping import interface, model
from adaptsim_jax.tasks.scooping import sphere_cloud as clouds
from adaptsim_jax.tasks.scooping.engines import scene
from adaptsim_jax.tasks.scooping.model import ScoopOptions

BATCH = 128
"""Samples of a call; each needs a model of its own."""


class Settings(NamedTuple):
    """dt: s; threads: cores to run on (None: all)."""

    dt: float = scene.DT
    threads: int | None = None


def make_native(options: ScoopOptions, dt: float, threads: int | None):
    """`simulate` by `mujoco.rollout` on `threads` cores (all). One batch runs at a time."""
    engine, lock = _Engine(options, dt, threads or os.cpu_count() or 1), threading.Lock()

    def simulate(params, commands, initial):
        params, actions, starts = interface.checked(params, commands, initial)
        good, params, actions = scene.fit(params, actions)
        positions = np.zeros((len(params), round(model.SECONDS / interface.ROW), scene.DOFS))
        with lock:
            for here, room in scene.batches(len(params), BATCH):
                positions[here] = engine.run(params[room], actions[room], here.stop - here.start)
        return scene.finished(positions, good, starts)

    return simulate


class _Engine:
    """A model for each sample of a batch; they are copied once, and the pieces in them
    rewritten.
    """

    def __init__(self, options: ScoopOptions, dt: float, threads: int):
        self.mujoco: Any = importlib.import_module("mujoco")
        self.model = scene.compiled(dt)
        self.rollout: Any = importlib.import_module("mujoco.rollout").Rollout(
            nthread=threads if threads > 1 else 0
        )
        self.data = [self.mujoco.MjData(self.model) for _ in range(threads)]
        self.prepare, self.rows = scene.jitted(options, dt), scene.rows(dt)
        self.models: list[Any] = []
        self.size = self.mujoco.mj_stateSize(
            self.model, self.mujoco.mjtState.mjSTATE_FULLPHYSICS.value
        )

    def run(self, params: np.ndarray, actions: np.ndarray, count: int) -> np.ndarray:
        """Positions `[count, T, 6]` in rows, of the first `count` samples."""
        kind = jnp.result_type(float)
        fields, (start, control) = self.prepare(
            jnp.asarray(params, kind), jnp.asarray(actions, kind)
        )
        fields = {name: np.asarray(value, float) for name, value in fields.items()}
        while len(self.models) < count:
            self.models.append(copy.copy(self.model))
        for i, m in enumerate(self.models[:count]):
            write_piece(m, {name: value[i] for name, value in fields.items()})
        state = np.zeros((count, self.size))
        state[:, 1 : 1 + scene.DOFS] = np.asarray(start, float)[:count]
        control = np.ascontiguousarray(np.asarray(control, float)[:count])
        out, _ = self.rollout.rollout(self.models[:count], self.data, state, control)
        return out[:, self.rows, 1 : 1 + scene.DOFS]


def write_piece(m: Any, piece: dict[str, np.ndarray]) -> None:
    """The piece of `scene.fields` into a compiled model, with all that MuJoCo derives of its
    mass.
    """
    first = m.geom("sphere0").id
    spheres = slice(first, first + clouds.SPHERES)
    for name in ("geom_pos", "geom_size", "geom_rbound", "geom_friction", "geom_solref"):
        getattr(m, name)[spheres] = piece[name]
    m.body_mass[scene.PIECE], m.body_inertia[scene.PIECE] = piece["mass"], piece["inertia"]
    m.body_subtreemass[scene.PIECE] = piece["mass"]
    m.body_invweight0[scene.PIECE], m.dof_invweight0[:3] = piece["weight"], piece["weights"]
    m.dof_M0[:3] = 1.0 / piece["weights"]


ENGINE = EngineKind(Settings, make_native)
