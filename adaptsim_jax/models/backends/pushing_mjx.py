"""The push in MJX: the same MJCF scene in JAX, with the patch inside the scanned step."""

from __future__ import annotations

import contextlib
import importlib
import io
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.models import pushing
from adaptsim_jax.models.backends import pushing_scene as scene
from adaptsim_jax.models.pushing import ElasticityMap, PushOptions

Array = Any


def make_mjx(options: PushOptions, elasticity: ElasticityMap, dt: float = 0.005):
    """`simulate` of the MJCF scene in MJX; in the precision that JAX is set to."""
    run = jax.jit(jax.vmap(make_push(options, elasticity, dt)))

    def simulate(params, commands, initial):
        batch = scene.checked(params, commands, initial)
        kind = jnp.result_type(float)
        # MJX relies on rank promotion, which a strict caller may have forbidden
        with jax.numpy_rank_promotion("allow"):
            state = run(*(jnp.asarray(a, kind) for a in batch[:3]))
        return scene.finished(state, batch)

    simulate.run = run
    return simulate


def make_push(options: PushOptions, elasticity: ElasticityMap, dt: float = 0.005):
    """`push(params [4], action [2], start [2]) -> state [T, 13]`: pure, for jit, vmap and grad."""
    with contextlib.redirect_stdout(io.StringIO()):  # MJX prints on its first import that optional parts are absent
        mjx: Any = importlib.import_module("mujoco.mjx")
    model = scene.model(options, dt)
    rest = scene.rest(model)
    feet, edge = scene.pair_ids(model)
    places = np.concatenate([pushing.feet(), np.full((4, 1), -pushing.HEIGHT / 2)], 1)
    base, blank = mjx.put_model(model), mjx.make_data(model)
    steps, every = round(options.duration / dt), round(options.row / dt)

    def push(params: Array, action: Array, start: Array) -> Array:
        friction = pushing.frictions(params, options.friction)
        k, b = pushing.spring(elasticity, params[1], options.mass, jnp)
        pairs = base.pair_friction.at[edge, :2].set(friction.plate)
        slips = base.pair_solreffriction
        scene_of_sample = base.replace(pair_solref=base.pair_solref.at[edge].set(jnp.stack([-k, -b])))

        def step(carry, control):
            qpos, qvel, warm = carry
            at = _feet_xy(qpos, places)
            on = pushing.on_patch(at[:, 0], at[:, 1], params[3], jnp)
            mu = friction.table + on * (friction.patch - friction.table)
            now = scene_of_sample.replace(
                pair_friction=pairs.at[feet, :2].set(mu[:, None]),
                pair_solreffriction=slips.at[feet, 1].set(-pushing.slip_damping(mu)),
            )
            # only what the next step needs is carried; all else of `Data` is rebuilt from the blank
            data = mjx.step(now, blank.replace(qpos=qpos, qvel=qvel, qacc_warmstart=warm, ctrl=control))
            return (data.qpos, data.qvel, data.qacc_warmstart), jnp.concatenate([data.qpos[:7], data.qvel[:6]])

        qpos = jnp.asarray(rest.qpos, params.dtype).at[:2].set(start).at[7].set(action[1])
        speeds = jnp.stack(
            [action[0], jnp.full_like(action[0], pushing.RISE_SPEED), jnp.full_like(action[0], pushing.PITCH_RATE)]
        )
        controls = jnp.asarray(pushing.slopes(dt, steps), params.dtype)[:, None] * speeds
        first = (qpos, jnp.zeros(model.nv, params.dtype), jnp.asarray(rest.warmstart, params.dtype))
        return jax.lax.scan(step, first, controls)[1][every - 1 :: every]

    return push


def _feet_xy(qpos: Array, places: np.ndarray) -> Array:
    """World x and y `[4, 2]` of the feet."""
    w, u = qpos[3], qpos[4:7]
    turned = places + 2 * jnp.cross(u[None], jnp.cross(u[None], places) + w * places)
    return qpos[:2] + turned[:, :2]
