"""The bottle push in four engines behind one signature: native MuJoCo, MJX, Drake, and the planar model.

`simulate(params [B, 4], commands [B, 2], initial [B, 2]) -> Trajectory`: commands are actions (speed m/s, angle rad), initial
the bottle's place m, and `state [B, T, 13]` the bottle's pose and velocity in rows (`scene.STATE`). Codes are
`pushing.MESSAGES`; states are finite whatever the code.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.engine import Backend, own_settings
from adaptsim_jax.tasks.pushing import model as pushing
from adaptsim_jax.tasks.pushing import planar as pushing_planar
from adaptsim_jax.tasks.pushing.engines import drake, mjx, native, scene
from adaptsim_jax.tasks.pushing.model import PAPER, PushOptions

NAMES = ("native", "mjx", "planar", "drake")


class PlanarSettings(NamedTuple):
    """coefficients: what calibration sets."""

    coefficients: pushing_planar.PlanarCoefficients = pushing_planar.DEFAULT


def make_backend(name: str, options: PushOptions = PAPER, /, **settings: Any) -> Backend:
    """A backend for `options`; BadInput where the name is unknown, the engine absent, or it cannot do the options or settings.

    `settings` are the engine's own, see `settings_of`; records may be given as tables.
    """
    kind, make = _engine(name)
    return Backend(name, make(pushing.check_options(options), *own_settings(name, kind, settings)))


def settings_of(name: str) -> tuple[str, ...]:
    """What settings the engine called `name` has of its own."""
    return _engine(name)[0]._fields


def _engine(name: str) -> tuple[Any, Callable]:
    engines = {
        "native": (native.Settings, native.make_native),
        "mjx": (mjx.Settings, mjx.make_mjx),
        "planar": (PlanarSettings, _planar),
        "drake": (drake.Settings, drake.make_drake),
    }
    if name not in engines:
        raise BadInput(f"backend '{name}' is unknown; use one of {', '.join(engines)}")
    return engines[name]


def _planar(options: PushOptions, coefficients: pushing_planar.PlanarCoefficients):
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
