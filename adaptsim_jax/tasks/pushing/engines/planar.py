"""The push's planar model as a backend, in double precision where JAX is set to it."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.tasks.engine import EngineKind
from adaptsim_jax.tasks.pushing import planar
from adaptsim_jax.tasks.pushing.engines import scene
from adaptsim_jax.tasks.pushing.model import PushOptions


class Settings(NamedTuple):
    """coefficients: what calibration sets."""

    coefficients: planar.PlanarCoefficients = planar.DEFAULT


def make_planar(options: PushOptions, coefficients: planar.PlanarCoefficients):
    planar.check_options(options)

    @jax.jit
    def run(params, actions, starts):
        one = lambda p, a, s: planar.trajectory(p, a, options, coefficients, s)
        return jax.vmap(one)(params, actions, starts)

    def simulate(params, commands, initial):
        batch = scene.checked(params, commands, initial)
        flat = np.asarray(run(*(jnp.asarray(a, jnp.result_type(float)) for a in batch[:3])))
        return scene.slid(flat[..., :2], flat[..., 2:], batch)

    return simulate


ENGINE = EngineKind(Settings, make_planar)
