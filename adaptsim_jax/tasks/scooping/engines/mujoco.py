"""Scooping in MuJoCo: the MJCF scene with the piece as a cloud of spheres, natively on all cores,
float64, and in MJX, with shape, height, friction and softness of every piece traced.
"""

from __future__ import annotations

import copy
import importlib
import os
import threading
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core.lazy import mjx_module
from adaptsim_jax.tasks.engine import EngineKind, filled_batches
from adaptsim_jax.tasks.scooping import model
from adaptsim_jax.tasks.scooping.engines import scene
from adaptsim_jax.tasks.scooping.model import ScoopOptions

Array = Any
BATCH = 128
"""Samples of a call; each needs a model of its own."""


class ScoopNativeSettings(NamedTuple):
    """dt: s. threads: Cores to run on (None: all)."""

    dt: float = scene.DT
    threads: int | None = None


def make_native(options: ScoopOptions, dt: float, threads: int | None):
    """`simulate` by `mujoco.rollout` on `threads` cores (all). One batch runs at a time."""
    engine, lock = ScoopEngine(options, dt, threads or os.cpu_count() or 1), threading.Lock()

    def simulate(params, commands, initial):
        params, actions, starts = model.checked_trials(params, commands, initial)
        good, params, actions = scene.fit(params, actions)
        positions = np.zeros((len(params), round(model.SECONDS / model.ROW), scene.DOFS))
        with lock:
            for here, room in filled_batches(len(params), BATCH):
                positions[here] = engine.run(params[room], actions[room], here.stop - here.start)
        return scene.finished(positions, good, starts)

    return simulate


class ScoopEngine:
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
    spheres = slice(first, first + scene.SPHERES)
    for name in ("geom_pos", "geom_size", "geom_rbound", "geom_friction", "geom_solref"):
        getattr(m, name)[spheres] = piece[name]
    m.body_mass[scene.PIECE], m.body_inertia[scene.PIECE] = piece["mass"], piece["inertia"]
    m.body_subtreemass[scene.PIECE] = piece["mass"]
    m.body_invweight0[scene.PIECE], m.dof_invweight0[:3] = piece["weight"], piece["weights"]
    m.dof_M0[:3] = 1.0 / piece["weights"]


NATIVE = EngineKind(ScoopNativeSettings, make_native)


class ScoopMJXSettings(NamedTuple):
    """dt: s. batch: Trials side by side."""

    dt: float = scene.DT
    batch: int = model.BATCH


def make_mjx(options: ScoopOptions, dt: float, batch: int):
    """`simulate` of the MJCF scene in MJX, `batch` trials side by side; in the precision that JAX
    is set to.
    """
    run = jax.jit(jax.vmap(make_scoop(options, dt)))

    def simulate(params, commands, initial):
        params, actions, starts = model.checked_trials(params, commands, initial)
        good, params, actions = scene.fit(params, actions)
        positions, kind = (
            np.zeros((len(params), round(model.SECONDS / model.ROW), scene.DOFS)),
            jnp.result_type(float),
        )
        # MJX relies on rank promotion, which a strict caller may have forbidden
        with jax.numpy_rank_promotion("allow"):
            for here, room in filled_batches(len(params), batch):
                found = run(jnp.asarray(params[room], kind), jnp.asarray(actions[room], kind))
                positions[here] = np.asarray(found)[: here.stop - here.start]
        return scene.finished(positions, good, starts)

    return simulate


def make_scoop(options: ScoopOptions, dt: float = scene.DT):
    """`scoop(params [4], action [3]) -> positions [T, 6]` in rows of 10 ms: pure, for jit and
    vmap.
    """
    mjx = mjx_module()
    compiled = scene.compiled(dt)
    base, blank, drive = (
        mjx.put_model(compiled),
        mjx.make_data(compiled),
        scene.make_drive(options, dt),
    )
    first = compiled.geom("sphere0").id

    def scoop(params: Array, action: Array) -> Array:
        m = _with_piece(base, scene.fields(params, dt), first)
        start, controls = drive(params, action)

        def step(carry, control):
            # only what the next step needs is carried; all else of `Data` is rebuilt from the blank
            qpos, qvel, warm = carry
            data = mjx.step(
                m, blank.replace(qpos=qpos, qvel=qvel, qacc_warmstart=warm, ctrl=control)
            )
            return (data.qpos, data.qvel, data.qacc_warmstart), data.qpos

        zero = jnp.zeros(scene.DOFS, params.dtype)
        return jax.lax.scan(step, (start, zero, zero), controls)[1][scene.rows(dt)]

    return scoop


def _with_piece(base: Any, piece: dict[str, Array], first: int) -> Any:
    """The model with the spheres and weights of `scene.fields`."""
    spheres, body = slice(first, first + scene.SPHERES), scene.PIECE

    def put(name, at, value):
        return getattr(base, name).at[at].set(value)

    new = {
        name: put(name, spheres, piece[name])
        for name in ("geom_pos", "geom_size", "geom_rbound", "geom_friction", "geom_solref")
    }
    return base.replace(
        **new,
        body_mass=put("body_mass", body, piece["mass"]),
        body_subtreemass=put("body_subtreemass", body, piece["mass"]),
        body_inertia=put("body_inertia", body, piece["inertia"]),
        body_invweight0=put("body_invweight0", body, piece["weight"]),
        dof_invweight0=put("dof_invweight0", slice(0, 3), piece["weights"]),
    )


MJX = EngineKind(ScoopMJXSettings, make_mjx)
