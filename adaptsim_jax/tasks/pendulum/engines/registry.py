"""The double pendulum in four engines behind one signature: our own, native MuJoCo, MJX, Drake."""

from __future__ import annotations

from typing import Any

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.registry import Registry
from adaptsim_jax.tasks.engine import Backend, EngineKind, own_settings

HERE = "adaptsim_jax.tasks.pendulum.engines"
BACKENDS: Registry[EngineKind] = Registry(
    "backends",
    {
        "rigid_body": f"{HERE}.rigid_body:ENGINE",
        "native": f"{HERE}.native:ENGINE",
        "mjx": f"{HERE}.mjx:ENGINE",
        "drake": f"{HERE}.drake:ENGINE",
    },
    within="pendulum",
)


def make_backend(name: str, dt: float = 1e-3, **settings: Any) -> Backend:
    """A backend with steps of `dt` s; BadInput where the name is unknown or the engine is not
    installed.

    `simulate(params [B, 10], commands [B, T, 2], initial [B, 4])`: `scene.PARAMETERS`; N m; rad and
    rad/s. `settings` are the engine's own.
    """
    kind = BACKENDS.named(name, "backend")
    if not 0 < dt <= 0.01:
        raise BadInput(
            f"backend {name}: a step of {dt} s is out of range; use one above 0 and up to 0.01 s"
        )
    return Backend(name, kind.make(dt, *own_settings(name, kind.settings, settings)))
