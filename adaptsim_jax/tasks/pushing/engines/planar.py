"""The push's planar model as a backend, in double precision where JAX is set to it."""

from dataclasses import asdict
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.tasks.engine import EngineKind
from adaptsim_jax.tasks.pushing import planar, slide
from adaptsim_jax.tasks.pushing.engines import scene
from adaptsim_jax.tasks.pushing.model import PARAMETERS, PushOptions


class Settings(NamedTuple):
    """coefficients: what calibration sets. lacking: what acts beside the declared; then it is the
    slide in two dimensions.
    """

    coefficients: planar.PlanarCoefficients = planar.DEFAULT
    lacking: slide.Lacking = slide.Lacking()


def make_planar(
    options: PushOptions, coefficients: planar.PlanarCoefficients, lacking: slide.Lacking
):
    planar.check_options(options)
    every = round(options.row / slide.ROW)

    def slid(p, a, s):
        values = asdict(lacking) | {name: p[i] for i, name in enumerate(PARAMETERS)}
        return slide.rollout(values, a, options, coefficients, s)[every::every]

    @jax.jit
    def run(params, actions, starts):
        def plain(p, a, s):
            return planar.trajectory(p, a, options, coefficients, s)

        return jax.vmap(plain if lacking == slide.Lacking() else slid)(params, actions, starts)

    def simulate(params, commands, initial):
        batch = scene.checked(params, commands, initial)
        flat = np.asarray(run(*(jnp.asarray(a, jnp.result_type(float)) for a in batch[:3])))
        return scene.slid(flat[..., :2], flat[..., 2:4], batch)

    return simulate


ENGINE = EngineKind(Settings, make_planar)
