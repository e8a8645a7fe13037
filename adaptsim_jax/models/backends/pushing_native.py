"""The push in native MuJoCo on all cores, with the patch."""

from __future__ import annotations

import copy
import importlib
import os
import threading
from typing import Any

import numpy as np

from adaptsim_jax.models import pushing
from adaptsim_jax.models.backends import pushing_scene as scene
from adaptsim_jax.models.pushing import ElasticityMap, PushOptions

BLOCK = 256  # samples at a time: each has a model of its own
FASTEST = 2.5  # m/s; no bottle moves faster, so one that is far from the patch needs no look at its feet


def make_native(options: PushOptions, elasticity: ElasticityMap, dt: float = 0.005, threads: int | None = None):
    """`simulate` of the MJCF scene by `mujoco.rollout`; float64, safe to call from several threads (one at a time)."""
    engine = _Engine(options, elasticity, dt, threads or os.cpu_count() or 1)

    def simulate(params, commands, initial):
        batch = scene.checked(params, commands, initial)
        blocks = [slice(i, i + BLOCK) for i in range(0, len(batch.fit), BLOCK)]
        state = [engine.run(*(a[b] for a in batch[:3])) for b in blocks]
        empty = np.zeros((0, pushing.rows(options), scene.STATE))
        return scene.finished(np.concatenate(state) if state else empty, batch)

    return simulate


class _Engine:
    """Models are copied once and rewritten for each batch: a copy costs as much as a tenth of a push."""

    def __init__(self, options: PushOptions, elasticity: ElasticityMap, dt: float, threads: int):
        mujoco: Any = importlib.import_module("mujoco")
        self.rollout: Any = importlib.import_module("mujoco.rollout")
        self.options, self.elasticity, self.dt = options, elasticity, dt
        self.model = scene.model(options, dt)
        self.rest = scene.rest(self.model)
        self.feet, self.edge = scene.pair_ids(self.model)
        self.places = np.concatenate([pushing.feet(), np.full((4, 1), -pushing.HEIGHT / 2 + 0.001)], 1)
        self.data = [mujoco.MjData(self.model) for _ in range(threads)]
        self.models: list[Any] = []
        self.lock = threading.Lock()

    def run(self, params: np.ndarray, actions: np.ndarray, starts: np.ndarray) -> np.ndarray:
        with self.lock:
            while len(self.models) < len(params):
                self.models.append(copy.copy(self.model))
            return self._run(params, actions, starts)

    def _run(self, params, actions, starts):
        steps = round(self.options.duration / self.dt)
        models = self.models[: len(params)]
        friction = self._prepare(models, params)
        state = self._initial(actions, starts)
        warm = np.tile(self.rest.warmstart, (len(params), 1))
        control = scene.controls(actions, self.dt, steps)
        out = np.empty((len(params), steps, state.shape[1]))
        data = self.data[: max(1, min(len(self.data), len(params)))]
        done = 0
        with self.rollout.Rollout(nthread=len(data) if len(data) > 1 else 0) as pool:
            while done < steps:
                block = min(self._ground(models, state, params[:, 3], friction), steps - done)
                piece, _ = pool.rollout(models, data, state, control[:, done : done + block], initial_warmstart=warm)
                out[:, done : done + block] = piece
                before = piece[:, -2] if block > 1 else state
                # Euler without damping: the change of velocity is the acceleration that the solver found
                warm = (piece[:, -1, 12:] - before[:, 12:]) / self.dt
                state = np.ascontiguousarray(piece[:, -1])
                done += block
        every = round(self.options.row / self.dt)
        rows = out[:, every - 1 :: every]
        return np.concatenate([rows[..., 1:8], rows[..., 12:18]], -1)

    def _prepare(self, models, params):
        """Contact constants of each sample into its model; table and patch friction `[B, 1]` come back."""
        friction = pushing.frictions(params, self.options.friction)
        k, b = pushing.spring(self.elasticity, params[:, 1], self.options.mass)
        for i, m in enumerate(models):
            m.pair_friction[self.edge, :2] = friction.plate[i]
            m.pair_solref[self.edge] = -k[i], -b[i]
        self.views = [m.pair_friction for m in models]
        self.written = np.full((len(models), 4), np.nan)
        return friction.table[:, None], friction.patch[:, None]

    def _initial(self, actions, starts):
        """Full-physics states `[B, 1 + 11 + 10]`: time, positions, velocities."""
        state = np.concatenate([[0.0], self.rest.qpos, np.zeros(10)])
        state = np.tile(state, (len(actions), 1))
        state[:, 1:3], state[:, 8] = starts, actions[:, 1]
        return state

    def _ground(self, models, state, y_p, friction) -> int:
        """Write each foot's friction where it changed, and say for how many steps none can change."""
        feet = state[:, None, 1:3] + _turned(state[:, 4:8], self.places)[..., :2]
        on = pushing.on_patch(feet[..., 0], feet[..., 1], y_p[:, None])
        mu = friction[0] + on * (friction[1] - friction[0])
        for i in np.flatnonzero((mu != self.written).any(1)):
            self.views[i][self.feet, :2] = mu[i][:, None]
        self.written = mu
        reach = (pushing.PATCH_SIDE + pushing.PATCH_EDGE) / 2
        away = np.maximum(np.abs(feet[..., 0] - pushing.PATCH_X), np.abs(feet[..., 1] - y_p[:, None])) - reach
        return max(1, int(away.min() / (FASTEST * self.dt)))


def _turned(q: np.ndarray, places: np.ndarray) -> np.ndarray:
    """`places [4, 3]` turned by each quaternion of `q [B, 4]`."""
    u, w = q[:, None, 1:], q[:, None, :1]
    return places + 2 * np.cross(u, np.cross(u, places) + w * places)
