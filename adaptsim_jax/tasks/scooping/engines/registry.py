"""Scooping in four engines behind one signature: ours in JAX (hydro), Drake, and a sphere cloud in MJX and native MuJoCo.

`simulate(params [B, 4], commands [B, 3], initial [B, 2]) -> Trajectory`: commands are actions as executed (pitch rad, rate rad/s,
distance m), initial the place of the piece m. `state [B, T, 6]` holds, in rows of 10 ms, the piece's x, y, z m and the tip's
x, z m and pitch rad. Codes are `scooping.MESSAGES`; states are finite whatever the code.
"""

from __future__ import annotations

from typing import Any

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.engine import Backend, own_settings
from adaptsim_jax.tasks.scooping import model
from adaptsim_jax.tasks.scooping.engines import drake, hydro, mjx, native
from adaptsim_jax.tasks.scooping.model import ScoopOptions

ENGINES = {
    "hydro": (hydro.Settings, hydro.make_hydro),
    "drake": (drake.Settings, drake.make_drake),
    "mjx": (mjx.Settings, mjx.make_mjx),
    "native": (native.Settings, native.make_native),
}
NAMES = tuple(ENGINES)


def make_backend(name: str, options: ScoopOptions = ScoopOptions(), /, **settings: Any) -> Backend:  # noqa: B008
    """A backend for `options`; BadInput where the name is unknown, the engine absent, or a setting makes no sense.

    `settings` are the engine's own, `Settings` in its module; records may be given as tables.
    """
    if name not in ENGINES:
        raise BadInput(f"backend '{name}' is unknown; use one of {', '.join(ENGINES)}")
    kind, make = ENGINES[name]
    return Backend(name, make(model.check_options(options), *own_settings(name, kind, settings)))
