"""Scooping in four engines behind one signature: ours in JAX (hydro), Drake, and a sphere cloud in
MJX and native MuJoCo.

`simulate(params [B, 4], commands [B, 3], initial [B, 2]) -> Trajectory`: commands are actions as
executed (pitch rad, rate rad/s, distance m), initial the place of the piece m. `state [B, T, 6]`
holds, in rows of 10 ms, the piece's x, y, z m and the tip's x, z m and pitch rad. Codes are
`scooping.MESSAGES`; states are finite whatever the code.
"""

from __future__ import annotations

from typing import Any

from adaptsim_jax.core.registry import Registry
from adaptsim_jax.tasks.engine import Backend, EngineKind, own_settings
from adaptsim_jax.tasks.scooping.model import ScoopOptions, check_options

HERE = "adaptsim_jax.tasks.scooping.engines"
BACKENDS: Registry[EngineKind] = Registry(
    "backends",
    {
        "hydro": f"{HERE}.hydro:ENGINE",
        "drake": f"{HERE}.drake:ENGINE",
        "mjx": f"{HERE}.mjx:ENGINE",
        "native": f"{HERE}.native:ENGINE",
    },
    within="scooping",
)


def make_backend(name: str, options: ScoopOptions = ScoopOptions(), /, **settings: Any) -> Backend:  # noqa: B008
    """A backend for `options`; BadInput where the name is unknown, the engine absent, or a setting
    makes no sense.

    `settings` are the engine's own, `Settings` in its module; records may be given as tables.
    """
    kind = BACKENDS.named(name, "backend")
    return Backend(
        name, kind.make(check_options(options), *own_settings(name, kind.settings, settings))
    )
