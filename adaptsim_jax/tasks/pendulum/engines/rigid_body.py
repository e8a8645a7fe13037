"""Our own rigid-body pendulum as a backend."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from adaptsim_jax.mechanisms.double_pendulum import rigid
from adaptsim_jax.tasks.engine import EngineKind, NoSettings
from adaptsim_jax.tasks.pendulum.engines import scene
from adaptsim_jax.tasks.pendulum.engines.scene import finished


def make_rigid_body(dt: float):
    def one(params, commands, initial):
        pair = lambda k: params[k : k + 2]
        p = rigid.RigidPendulum(pair(0), pair(2), pair(4), pair(6), pair(8), scene.GRAVITY)
        out = rigid.simulate(p, initial[:2], initial[2:], commands, dt)
        return jnp.concatenate([out.q[1:], out.v[1:]], -1)

    run = jax.jit(jax.vmap(one))
    return lambda params, commands, initial: finished(run(*map(jnp.asarray, (params, commands, initial))))


ENGINE = EngineKind(NoSettings, make_rigid_body)
