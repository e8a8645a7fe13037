"""The bottle push in four engines behind one signature: native MuJoCo, MJX, Drake, and the planar model.

`simulate(params [B, 4], commands [B, 2], initial [B, 2]) -> Trajectory`: commands are actions (speed m/s, angle rad), initial
the bottle's place m, and `state [B, T, 13]` the bottle's pose and velocity in rows (`pushing_scene.STATE`). Codes are
`pushing.MESSAGES`; states are finite whatever the code.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.errors import BadInput
from adaptsim_jax.models import pushing, pushing_planar
from adaptsim_jax.models.backends import pushing_scene as scene
from adaptsim_jax.models.backends.base import Backend
from adaptsim_jax.models.pushing import PAPER, PushOptions

NAMES = ("native", "mjx", "planar", "drake")


def make_backend(name: str, options: PushOptions = PAPER, **settings: Any) -> Backend:
    """A backend for `options`; BadInput where the name is unknown, the engine absent, or it cannot do the options.

    `settings` are the engine's own: `elasticity` of native and mjx, `coefficients` of planar, `dt` and `contact` of drake.
    """
    makers = {"native": _native, "mjx": _mjx, "planar": _planar, "drake": _drake}
    if name not in makers:
        raise BadInput(f"backend '{name}' is unknown; use one of {', '.join(makers)}")
    return Backend(name, makers[name](pushing.check_options(options), **settings))


def _native(options: PushOptions, **settings: Any):
    from adaptsim_jax.models.backends.pushing_native import make_native

    return make_native(options, **{"elasticity": pushing.ELASTICITY, **settings})


def _mjx(options: PushOptions, **settings: Any):
    from adaptsim_jax.models.backends.pushing_mjx import make_mjx

    return make_mjx(options, **{"elasticity": pushing.ELASTICITY, **settings})


def _drake(options: PushOptions, **settings: Any):
    from adaptsim_jax.models.backends.pushing_drake import make_drake

    return make_drake(options, **settings)


def _planar(options: PushOptions, coefficients: pushing_planar.PlanarCoefficients = pushing_planar.DEFAULT):
    pushing_planar.check_options(options)

    @jax.jit
    def run(params, actions, starts):
        one = lambda p, a, s: pushing_planar.trajectory(p, a, options, coefficients, s)
        return jax.vmap(one)(params, actions, starts)

    def simulate(params, commands, initial):
        batch = scene.checked(params, commands, initial)
        flat = np.asarray(run(*(jnp.asarray(a, jnp.result_type(float)) for a in batch[:3])))
        return scene.slid(flat[..., :2], flat[..., 2:], batch)

    return simulate
