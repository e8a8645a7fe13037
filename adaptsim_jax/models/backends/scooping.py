"""Scooping in four engines behind one signature: ours in JAX (hydro), Drake, and a sphere cloud in MJX and native MuJoCo.

`simulate(params [B, 4], commands [B, 3], initial [B, 2]) -> Trajectory`: commands are actions as executed (pitch rad, rate rad/s,
distance m), initial the place of the piece m. `state [B, T, 6]` holds, in rows of 10 ms, the piece's x, y, z m and the tip's
x, z m and pitch rad. Codes are `scooping.MESSAGES`; states are finite whatever the code.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.errors import BadInput
from adaptsim_jax.models import scooping as model
from adaptsim_jax.models import scooping_hydro as hydro
from adaptsim_jax.models.backends.base import Backend, Trajectory, own_settings
from adaptsim_jax.models.scooping import ScoopOptions
from adaptsim_jax.models.scooping_hydro import Numerics

NAMES = ("hydro", "drake", "mjx", "native")
ROW = 0.01  # s between rows; row k is at (k + 1) ROW
STATE = 6
BATCH = 64  # trials side by side on a CPU: more do not fit into its cache


class HydroSettings(NamedTuple):
    """numerics: what makes up the simulator besides physics."""

    numerics: Numerics = Numerics()


def make_backend(name: str, options: ScoopOptions = ScoopOptions(), /, **settings: Any) -> Backend:  # noqa: B008
    """A backend for `options`; BadInput where the name is unknown, the engine absent, or a setting makes no sense.

    `settings` are the engine's own: of hydro `HydroSettings`, of others `Settings` in their module; records may be given as tables.
    """
    kind, make = _engine(name)
    return Backend(name, make(model.check_options(options), *own_settings(name, kind, settings)))


def _engine(name: str) -> tuple[Any, Callable]:
    # these modules need this one
    from adaptsim_jax.models.backends import scooping_drake as drake
    from adaptsim_jax.models.backends import scooping_mjx as mjx
    from adaptsim_jax.models.backends import scooping_native as native

    engines = {
        "hydro": (HydroSettings, _hydro),
        "drake": (drake.Settings, drake.make_drake),
        "mjx": (mjx.Settings, mjx.make_mjx),
        "native": (native.Settings, native.make_native),
    }
    if name not in engines:
        raise BadInput(f"backend '{name}' is unknown; use one of {', '.join(engines)}")
    return engines[name]


def _hydro(options: ScoopOptions, numerics: Numerics):
    hydro.check_numerics(numerics)
    every = round(ROW / numerics.dt)
    if abs(ROW / numerics.dt - every) > 1e-6:
        raise BadInput(f"backend hydro, dt = {numerics.dt} s must divide the row of {ROW} s; use 0.0025")

    @jax.jit
    @jax.vmap
    def run(params, action):
        out = hydro.rollout(params, action, options, numerics)
        rows = slice(every, None, every)
        return out.piece[rows, :2], out.tip[rows], out.code

    def simulate(params, commands, initial):
        params, actions, starts = checked(params, commands, initial)
        state, codes = np.zeros((len(params), round(model.SECONDS / ROW), STATE)), np.zeros(len(params), int)
        for at in range(0, len(params), BATCH):
            room = np.minimum(np.arange(at, at + BATCH), len(params) - 1)  # the last batch is filled up
            kind = jnp.result_type(float)
            piece, tip, code = run(jnp.asarray(params[room], kind), jnp.asarray(actions[room], kind))
            here = slice(at, min(at + BATCH, len(params)))
            count = here.stop - at
            state[here, :, 0], state[here, :, 2] = np.moveaxis(np.asarray(piece)[:count], -1, 0)
            state[here, :, 3:], codes[here] = np.asarray(tip)[:count], np.asarray(code)[:count]
        return placed(state, codes, starts)

    return simulate


def checked(params: Any, commands: Any, initial: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The batch as arrays `[B, 4]`, `[B, 3]`, `[B, 2]`; BadInput where shapes do not fit together."""
    arrays = np.asarray(params, float), np.asarray(commands, float), np.asarray(initial, float)
    for name, array, width in zip(("params", "commands", "initial"), arrays, (4, 3, 2), strict=True):
        if array.ndim != 2 or array.shape[1] != width or len(array) != len(arrays[0]):
            raise BadInput(
                f"scooping: {name} has shape {array.shape}, needs [{len(arrays[0])}, {width}]; check its columns"
            )
    return arrays


def placed(state: np.ndarray, codes: np.ndarray, starts: np.ndarray) -> Trajectory:
    """The trajectory with lengths along the table counted as the caller does."""
    state[..., 0] += starts[:, None, 0]
    state[..., 1] += starts[:, None, 1]
    state[..., 3] += starts[:, None, 0]
    return Trajectory(state, codes)


def outcome(state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`(success [B], above [B] m)` at the end of `state [B, T, 6]`; `above`: height over the tip's plane."""
    x, _, z, tip_x, tip_z, pitch = np.moveaxis(state[:, -1], -1, 0)
    c, s = np.cos(pitch), np.sin(pitch)
    ahead, above = c * (x - tip_x) - s * (z - tip_z), s * (x - tip_x) + c * (z - tip_z)
    return np.asarray(model.on_blade(ahead, above)), above
