"""The push in MJX: the same MJCF scene in JAX, with the patch inside the scanned step."""

from __future__ import annotations

import contextlib
import importlib
import io
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from adaptsim_jax.tasks.engine import EngineKind
from adaptsim_jax.tasks.pushing import model as pushing
from adaptsim_jax.tasks.pushing.engines import scene
from adaptsim_jax.tasks.pushing.model import ElasticityMap, PushOptions

Array = Any


class Settings(NamedTuple):
    """elasticity: of plate and bottle; dt: s."""

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
    with contextlib.redirect_stdout(
        io.StringIO()
    ):  # MJX prints on its first import that optional parts are absent
        mjx: Any = importlib.import_module("mujoco.mjx")
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


ENGINE = EngineKind(Settings, make_mjx)
