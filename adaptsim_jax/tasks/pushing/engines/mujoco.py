"""The push in MuJoCo: the MJCF scene with its patch, natively on all cores, and in MJX."""

from __future__ import annotations

import copy
import importlib
import os
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core.lazy import mjx_module
from adaptsim_jax.tasks.engine import EngineKind
from adaptsim_jax.tasks.pushing import model as pushing
from adaptsim_jax.tasks.pushing.engines import scene
from adaptsim_jax.tasks.pushing.model import ElasticityMap, PushOptions

Array = Any
BLOCK = 100
"""Samples at a time on a thread: more would share fewer calls of the engine, and each needs a model
of its own.
"""
AT_REST = 1e-4  # m/s and rad/s; such a bottle goes no further than a micrometre


class PushNativeSettings(NamedTuple):
    """elasticity: Of plate and bottle; dt: s. threads: Cores to run on (None: all); gravity: m/s2,
    turned where the table is not level.
    """

    elasticity: ElasticityMap = pushing.ELASTICITY
    dt: float = 0.005
    threads: int | None = None
    gravity: tuple[float, float, float] = pushing.LEVEL


def make_native(
    options: PushOptions,
    elasticity: ElasticityMap,
    dt: float,
    threads: int | None,
    gravity=pushing.LEVEL,
):
    """`simulate` of the MJCF scene by `mujoco.rollout` on `threads` cores (all); float64. One batch
    runs at a time.
    """
    engines = [
        PushEngine(options, elasticity, dt, gravity) for _ in range(threads or os.cpu_count() or 1)
    ]
    lock = threading.Lock()

    def simulate(params, commands, initial):
        batch = scene.checked(params, commands, initial)
        count = len(batch.fit)
        size = max(1, min(BLOCK, -(-count // len(engines))))
        # pushes of like speed reach the patch at like times, and then step together in long
        # stretches
        order = np.argsort(batch.actions[:, 0], kind="stable")
        blocks = [order[i : i + size] for i in range(0, count, size)]
        state = np.zeros((count, pushing.rows(options), scene.STATE))

        def work(engine: PushEngine) -> None:
            while blocks:
                try:
                    mine = blocks.pop()
                except IndexError:  # another thread was faster
                    return
                state[mine] = engine.run(
                    batch.params[mine], batch.actions[mine], batch.starts[mine]
                )

        with lock, ThreadPoolExecutor(len(engines)) as pool:
            list(pool.map(work, engines))
        return scene.finished(state, batch)

    return simulate


class PushEngine:
    """One thread's engine. Models are copied once and rewritten for each batch: a copy costs a
    tenth of a push.
    """

    def __init__(self, options: PushOptions, elasticity: ElasticityMap, dt: float, gravity):
        mujoco: Any = importlib.import_module("mujoco")
        self.rollout: Any = importlib.import_module("mujoco.rollout").Rollout(nthread=0)
        state = mujoco.mjtState
        self.control_spec = state.mjSTATE_CTRL.value | state.mjSTATE_QFRC_APPLIED.value
        self.options, self.elasticity, self.dt = options, elasticity, dt
        self.model = scene.model(options, dt)
        self.model.opt.disableflags |= (
            mujoco.mjtDisableBit.mjDSBL_ISLAND.value
        )  # one island: the search costs, and finds it
        self.rest = scene.rest(self.model)
        self.model.opt.gravity[:] = gravity
        self.level = gravity[:2] == (0.0, 0.0)
        self.edge = self.model.pair("edge").id
        self.data = [mujoco.MjData(self.model)]
        self.models: list[Any] = []
        self.ground = GroundFriction()

    def run(self, params: np.ndarray, actions: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Rows `[B, T, 13]` of a block: one call of the engine a step, since friction follows the
        bottle.
        """
        steps = round(self.options.duration / self.dt)
        friction = pushing.frictions(params, self.options.friction)
        models = self._prepare(params, actions, friction.plate)
        ground = self.ground.on(friction, params[:, 3], self.options.mass, self.dt)
        control = np.zeros((len(params), steps, 3 + 10))
        control[:, :, :3] = scene.controls(actions, self.dt, steps)
        state, warm = self._initial(actions, starts), np.tile(self.rest.warmstart, (len(params), 1))
        out = np.empty((len(params), steps, scene.STATE))
        done, untouched = 0, self._untouched(actions[:, 0].max(), _closer(starts), steps)
        while done < steps:
            count = max(1, untouched - done)
            pose = _pose(state)
            if done >= untouched:
                control[:, done, 3:9] = ground(pose)
                if done * self.dt > pushing.PUSH_ENDS and np.abs(pose[:, 7:]).max() < AT_REST:
                    out[:, done:] = pose[:, None]
                    break
            piece = self._advance(models, state, control[:, done : done + count], warm)
            out[:, done : done + count] = _pose(piece)
            # Euler without damping: the change of velocity is the acceleration that the solver
            # found
            before = piece[:, -2] if count > 1 else state
            state = np.ascontiguousarray(piece[:, -1])
            warm = (state[:, 12:] - before[:, 12:]) / self.dt
            done += count
        every = round(self.options.row / self.dt)
        return out[:, every - 1 :: every]

    def _untouched(self, fastest: float, closest: float, steps: int) -> int:
        """How many steps end before the fastest plate of the block can touch a bottle `closest` m
        nearer than usual.

        None where friction holds the bottle on a slope until then.
        """
        if not self.level:
            return 0
        ramp = pushing.ramp(np.arange(1, steps + 1) * self.dt)
        travel = np.cumsum(ramp) * self.dt
        edge = (
            fastest * travel
            + pushing.EDGE_DROP * np.sin(pushing.PITCH_RATE * travel)
            + pushing.EDGE_RADIUS
        )
        gap = pushing.LINK_BACK - pushing.RADIUS - 0.005 - closest
        return int((edge < gap).sum())

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

    def _prepare(self, params: np.ndarray, actions: np.ndarray, plate: np.ndarray) -> list[Any]:
        """A model for each sample with its contact of plate and bottle."""
        while len(self.models) < len(params):
            self.models.append(copy.copy(self.model))
        models = self.models[: len(params)]
        k, b = pushing.spring(self.elasticity, params[:, 1], actions[:, 0], self.options.mass)
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


@jax.jit
def _friction(pose, friction, y_p, mass, dt):
    return pushing.ground_friction(pose, friction, y_p, mass, dt, jnp)


class GroundFriction:
    """The ground's friction for a block, compiled by JAX on the CPU: a third of NumPy's time, and
    it is asked each step.
    """

    def __init__(self) -> None:
        self.cpu = jax.local_devices(backend="cpu")[0]

    def on(self, friction: pushing.Frictions, y_p: np.ndarray, mass: float, dt: float):
        """`pose [B, 13] -> force [B, 6]`; blocks are filled up to powers of two, so that few sizes
        are compiled.
        """
        count = len(y_p)
        size = max(16, 1 << (count - 1).bit_length())

        def fill(a):
            return np.concatenate([a, np.repeat(a[:1], size - count, 0)])

        columns = [fill(np.asarray(a, float))[:, None] for a in (*friction, y_p)]
        pose_filled = np.zeros((size, scene.STATE))
        pose_filled[:, 3] = 1.0

        def force(pose: np.ndarray) -> np.ndarray:
            pose_filled[:count] = pose
            with (
                jax.enable_x64(True),
                jax.default_device(self.cpu),
                jax.numpy_rank_promotion("allow"),
            ):
                found = _friction(
                    pose_filled, pushing.Frictions(*columns[:3]), columns[3], mass, dt
                )
            return np.asarray(found)[:count]

        return force


def _closer(starts: np.ndarray) -> float:
    """By how much a bottle stands nearer to the plate than usual, at most: m."""
    return float(np.linalg.norm(starts - np.array(pushing.START), axis=1).max(initial=0.0))


def _pose(state: np.ndarray) -> np.ndarray:
    """Pose and velocity `[..., 13]` of the bottle in full-physics states."""
    return np.concatenate([state[..., 1:8], state[..., 12:18]], -1)


NATIVE = EngineKind(PushNativeSettings, make_native)


class PushMJXSettings(NamedTuple):
    """elasticity: Of plate and bottle; dt: s."""

    elasticity: ElasticityMap = pushing.ELASTICITY
    dt: float = 0.005


def make_mjx(options: PushOptions, elasticity: ElasticityMap, dt: float):
    """`simulate` of the MJCF scene in MJX; in the precision that JAX is set to."""
    run = jax.jit(jax.vmap(make_push(options, elasticity, dt)))

    def simulate(params, commands, initial):
        batch = scene.checked(params, commands, initial)
        kind = jnp.result_type(float)
        # MJX relies on rank promotion, which a strict caller may have forbidden
        with jax.numpy_rank_promotion("allow"):
            state = run(*(jnp.asarray(a, kind) for a in batch[:3]))
        return scene.finished(state, batch)

    return simulate


def make_push(options: PushOptions, elasticity: ElasticityMap, dt: float = 0.005):
    """`push(params [4], action [2], start [2]) -> state [T, 13]`: pure, for jit, vmap and grad."""
    mjx = mjx_module()
    model = scene.model(options, dt)
    rest = scene.rest(model)
    edge = model.pair("edge").id
    base, blank = mjx.put_model(model), mjx.make_data(model)
    steps, every = round(options.duration / dt), round(options.row / dt)

    def push(params: Array, action: Array, start: Array) -> Array:
        friction = pushing.frictions(params, options.friction)
        k, b = pushing.spring(elasticity, params[1], action[0], options.mass, jnp)
        m = base.replace(
            pair_friction=base.pair_friction.at[edge, :2].set(friction.plate),
            pair_solref=base.pair_solref.at[edge].set(jnp.stack([-k, -b])),
        )

        def step(carry, control):
            qpos, qvel, warm = carry
            pose = jnp.concatenate([qpos[:7], qvel[:6]])
            ground = pushing.ground_friction(pose, friction, params[3], options.mass, dt, jnp)
            applied = jnp.zeros_like(qvel).at[:6].set(ground)
            # only what the next step needs is carried; all else of `Data` is rebuilt from the blank
            data = blank.replace(
                qpos=qpos, qvel=qvel, qacc_warmstart=warm, ctrl=control, qfrc_applied=applied
            )
            data = mjx.step(m, data)
            return (data.qpos, data.qvel, data.qacc_warmstart), jnp.concatenate(
                [data.qpos[:7], data.qvel[:6]]
            )

        qpos = jnp.asarray(rest.qpos, params.dtype).at[:2].set(start).at[7].set(action[1])
        speeds = jnp.stack(
            [
                action[0],
                jnp.full_like(action[0], pushing.RISE_SPEED),
                jnp.full_like(action[0], pushing.PITCH_RATE),
            ]
        )
        controls = jnp.asarray(pushing.slopes(dt, steps), params.dtype)[:, None] * speeds
        first = (qpos, jnp.zeros(model.nv, params.dtype), jnp.asarray(rest.warmstart, params.dtype))
        return jax.lax.scan(step, first, controls)[1][every - 1 :: every]

    return push


MJX = EngineKind(PushMJXSettings, make_mjx)
