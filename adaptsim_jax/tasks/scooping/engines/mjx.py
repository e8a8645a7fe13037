"""Scooping in MJX: the same MJCF scene in JAX, with shape, height, friction and softness of every
piece traced.
"""

from __future__ import annotations

import contextlib
import importlib
import io
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.tasks.engine import EngineKind
from adaptsim_jax.tasks.scooping import interface, model
from adaptsim_jax.tasks.scooping import sphere_cloud as clouds
from adaptsim_jax.tasks.scooping.engines import scene
from adaptsim_jax.tasks.scooping.model import ScoopOptions

Array = Any


class Settings(NamedTuple):
    """dt: s; batch: trials side by side."""

    dt: float = scene.DT
    batch: int = interface.BATCH


def make_mjx(options: ScoopOptions, dt: float, batch: int):
    """`simulate` of the MJCF scene in MJX, `batch` trials side by side; in the precision that JAX
    is set to.
    """
    run = jax.jit(jax.vmap(make_scoop(options, dt)))

    def simulate(params, commands, initial):
        params, actions, starts = interface.checked(params, commands, initial)
        good, params, actions = scene.fit(params, actions)
        positions, kind = (
            np.zeros((len(params), round(model.SECONDS / interface.ROW), scene.DOFS)),
            jnp.result_type(float),
        )
        # MJX relies on rank promotion, which a strict caller may have forbidden
        with jax.numpy_rank_promotion("allow"):
            for here, room in scene.batches(len(params), batch):
                found = run(jnp.asarray(params[room], kind), jnp.asarray(actions[room], kind))
                positions[here] = np.asarray(found)[: here.stop - here.start]
        return scene.finished(positions, good, starts)

    return simulate


def make_scoop(options: ScoopOptions, dt: float = scene.DT):
    """`scoop(params [4], action [3]) -> positions [T, 6]` in rows of 10 ms: pure, for jit and
    vmap.
    """
    with contextlib.redirect_stdout(
        io.StringIO()
    ):  # MJX prints on its first import that optional parts are absent
        mjx: Any = importlib.import_module("mujoco.mjx")
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
    spheres, body = slice(first, first + clouds.SPHERES), scene.PIECE

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


ENGINE = EngineKind(Settings, make_mjx)
