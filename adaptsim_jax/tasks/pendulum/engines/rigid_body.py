"""Our own rigid-body pendulum as a backend: the plant that mended models are made of, without
effects.
"""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp

from adaptsim_jax.mechanisms.closed_loop import broadcasts
from adaptsim_jax.mechanisms.double_pendulum.plant import base_parameters, rigid_pendulum
from adaptsim_jax.mechanisms.stepping import make_model, row_step
from adaptsim_jax.tasks.engine import EngineKind, NoSettings
from adaptsim_jax.tasks.pendulum.engines import scene
from adaptsim_jax.tasks.pendulum.engines.scene import finished


def make_rigid_body(dt: float):
    plant = rigid_pendulum("hanging", {"l1": 1.0, "g": scene.GRAVITY}, {})

    @jax.jit
    @broadcasts
    def run(params, commands, initial):
        m1, m2, l1, _, c1, c2, i1, i2, b1, b2 = params.T
        theta = base_parameters((m1, m2), l1, (c1, c2), (i1, i2), (b1, b2))
        model = make_model(replace(plant, constants={**plant.constants, "l1": l1}), ())
        step = jnp.full_like(l1, dt)

        def row(x, u):
            x, _ = row_step(model, theta, jnp.zeros(0), x, (), u, 0.0, step)
            return x, jnp.stack(x)

        states = jax.lax.scan(row, list(initial.T), jnp.transpose(commands, (1, 2, 0)))[1]
        return jnp.transpose(states, (2, 0, 1))

    return lambda params, commands, initial: finished(
        run(*map(jnp.asarray, (params, commands, initial)))
    )


ENGINE = EngineKind(NoSettings, make_rigid_body)
