"""The push in native MuJoCo on all cores, with the patch."""

from __future__ import annotations

import copy
import importlib
import os
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from adaptsim_jax.models import pushing
from adaptsim_jax.models.backends import pushing_scene as scene
from adaptsim_jax.models.pushing import ElasticityMap, PushOptions

BLOCK = 100
"""Samples at a time on a thread: more would share fewer calls of the engine, and each needs a model of its own."""


def make_native(options: PushOptions, elasticity: ElasticityMap, dt: float = 0.005, threads: int | None = None):
    """`simulate` of the MJCF scene by `mujoco.rollout` on `threads` cores (all); float64. One batch runs at a time."""
    engines = [_Engine(options, elasticity, dt) for _ in range(threads or os.cpu_count() or 1)]
    lock = threading.Lock()

    def simulate(params, commands, initial):
        batch = scene.checked(params, commands, initial)
        count = len(batch.fit)
        size = max(1, min(BLOCK, -(-count // len(engines))))
        # pushes of like speed reach the patch at like times, and then step together in long stretches
        order = np.argsort(batch.actions[:, 0], kind="stable")
        blocks = [order[i : i + size] for i in range(0, count, size)]
        state = np.zeros((count, pushing.rows(options), scene.STATE))

        def work(engine: _Engine) -> None:
            while blocks:
                try:
                    mine = blocks.pop()
                except IndexError:  # another thread was faster
                    return
                state[mine] = engine.run(batch.params[mine], batch.actions[mine], batch.starts[mine])

        with lock, ThreadPoolExecutor(len(engines)) as pool:
            list(pool.map(work, engines))
        return scene.finished(state, batch)

    return simulate


class _Engine:
    """One thread's engine. Models are copied once and rewritten for each batch: a copy costs a tenth of a push."""

    def __init__(self, options: PushOptions, elasticity: ElasticityMap, dt: float):
        mujoco: Any = importlib.import_module("mujoco")
        self.rollout: Any = importlib.import_module("mujoco.rollout").Rollout(nthread=0)
        self.control_spec = mujoco.mjtState.mjSTATE_CTRL.value
        self.options, self.elasticity, self.dt = options, elasticity, dt
        self.model = scene.model(options, dt)
        self.rest = scene.rest(self.model)
        self.feet, self.edge = scene.pair_ids(self.model)
        self.places = np.concatenate([pushing.feet(), np.full((4, 1), -pushing.HEIGHT / 2)], 1).T
        self.data = [mujoco.MjData(self.model)]
        self.models: list[Any] = []

    def run(self, params: np.ndarray, actions: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Rows `[B, T, 13]` of a block."""
        steps = round(self.options.duration / self.dt)
        models = self._prepare(params)
        ground = _Ground(models, self.feet, params, actions, self.options, self.places)
        control = scene.controls(actions, self.dt, steps)
        state = self._initial(actions, starts)
        warm = np.tile(self.rest.warmstart, (len(params), 1))
        out = np.empty((len(params), steps, state.shape[1]))
        done = 0
        while done < steps:
            ground.write(state)
            count = min(max(1, int(ground.free(state, done * self.dt) / self.dt)), steps - done)
            piece = self._advance(models, state, control[:, done : done + count], warm)
            out[:, done : done + count] = piece
            # Euler without damping: the change of velocity is the acceleration that the solver found
            before = piece[:, -2] if count > 1 else state
            state = np.ascontiguousarray(piece[:, -1])
            warm = (state[:, 12:] - before[:, 12:]) / self.dt
            done += count
        every = round(self.options.row / self.dt)
        rows = out[:, every - 1 :: every]
        return np.concatenate([rows[..., 1:8], rows[..., 12:18]], -1)

    def _advance(self, models, state, control, warm) -> np.ndarray:
        piece = np.empty((*control.shape[:2], state.shape[1]))
        nothing = np.empty((*control.shape[:2], 0))
        self.rollout.rollout(
            models,
            self.data,
            state,
            np.ascontiguousarray(control),
            control_spec=self.control_spec,
            skip_checks=True,
            nstep=control.shape[1],
            initial_warmstart=warm,
            state=piece,
            sensordata=nothing,
        )
        return piece

    def _prepare(self, params: np.ndarray) -> list[Any]:
        """A model for each sample with its contact of plate and bottle."""
        while len(self.models) < len(params):
            self.models.append(copy.copy(self.model))
        models = self.models[: len(params)]
        plate = pushing.frictions(params, self.options.friction).plate
        k, b = pushing.spring(self.elasticity, params[:, 1], self.options.mass)
        for i, m in enumerate(models):
            m.pair_friction[self.edge, :2] = plate[i]
            m.pair_solref[self.edge] = -k[i], -b[i]
        return models

    def _initial(self, actions: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Full-physics states `[B, 1 + 11 + 10]`: time, positions, velocities."""
        state = np.concatenate([[0.0], self.rest.qpos, np.zeros(10)])
        state = np.tile(state, (len(actions), 1))
        state[:, 1:3], state[:, 8] = starts, actions[:, 1]
        return state


class _Ground:
    """The friction under each foot, written into the models where it changed."""

    def __init__(self, models, pairs, params, actions, options: PushOptions, places: np.ndarray):
        rows = slice(pairs[0], pairs[-1] + 1)
        self.views = [(m.pair_friction[rows, :2], m.pair_solreffriction[rows, 1]) for m in models]
        friction = pushing.frictions(params, options.friction)
        self.table, self.patch, self.y_p = friction.table[:, None], friction.patch[:, None], params[:, 3, None]
        self.places = places
        self.written = np.full((len(models), 4), np.nan)
        # an elastic hit gives a light bottle at most twice the edge's speed
        self.fastest = 2 * (actions[:, 0] + pushing.PITCH_RATE * pushing.EDGE_DROP)

    def write(self, state: np.ndarray) -> None:
        x, y = self._feet(state)
        on = pushing.on_patch(x, y, self.y_p)
        mu = self.table + on * (self.patch - self.table)
        damping = -pushing.slip_damping(mu)
        for i in np.flatnonzero((mu != self.written).any(1)):
            grip, slip = self.views[i]
            grip[:], slip[:] = mu[i][:, None], damping[i]
        self.written = mu

    def free(self, state: np.ndarray, time: float) -> float:
        """For how many seconds no foot can come to, or be on, the patch's edge."""
        x, y = self._feet(state)
        half, edge = pushing.PATCH_SIDE / 2, pushing.PATCH_EDGE / 2
        beyond = np.maximum(np.abs(x - pushing.PATCH_X), np.abs(y - self.y_p)) - half
        away = (np.abs(beyond) - edge).min(1)
        speed = np.hypot(state[:, 12], state[:, 13]) + 0.01
        if time < pushing.STILL + pushing.RAMP_UP + pushing.HOLD + pushing.RAMP_DOWN:
            speed = np.maximum(speed, self.fastest)
        return float((away / speed).min())

    def _feet(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """World x and y `[B, 4]` of the feet."""
        w, x, y, z = state[:, 4:8].T[..., None]
        px, py, pz = self.places
        fx = (1 - 2 * (y * y + z * z)) * px + 2 * (x * y - w * z) * py + 2 * (x * z + w * y) * pz
        fy = 2 * (x * y + w * z) * px + (1 - 2 * (x * x + z * z)) * py + 2 * (y * z - w * x) * pz
        return state[:, 1:2] + fx, state[:, 2:3] + fy
