"""The double pendulum in MJX, in the precision that JAX is set to."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.tasks.engine import EngineKind, NoSettings
from adaptsim_jax.tasks.pendulum.engines import scene
from adaptsim_jax.tasks.pendulum.engines.scene import finished


def make_mjx(dt: float):
    from mujoco import mjx

    def batched(params):
        models = [scene.model(p, dt) for p in np.asarray(params)]
        varied = ("body_mass", "body_inertia", "body_ipos", "body_pos", "dof_damping")
        stacked = {name: jnp.stack([getattr(m, name) for m in models]) for name in varied}
        return mjx.put_model(models[0]), stacked

    @jax.jit
    def run(base, stacked, commands, initial):
        def one(values, commands, initial):
            m = base.tree_replace(values)
            data = mjx.make_data(m).replace(qpos=initial[:2], qvel=initial[2:])

            def step(data, command):
                data = mjx.step(m, data.replace(ctrl=command))
                return data, jnp.concatenate([data.qpos, data.qvel])

            return jax.lax.scan(step, data, commands)[1]

        return jax.vmap(one)(stacked, commands, initial)

    def simulate(params, commands, initial):
        # MJX relies on rank promotion, which a strict caller may have forbidden
        with jax.numpy_rank_promotion("allow"):
            return finished(run(*batched(params), jnp.asarray(commands), jnp.asarray(initial)))

    return simulate


ENGINE = EngineKind(NoSettings, make_mjx)
