"""The bottle push in four engines behind one signature: native MuJoCo, MJX, Drake, and the planar
model.

`simulate(params [B, 4], commands [B, 2], initial [B, 2]) -> Trajectory`: commands are actions
(speed m/s, angle rad), initial the bottle's place m, and `state [B, T, 13]` the bottle's pose and
velocity in rows (`scene.STATE`). Codes are `pushing.MESSAGES`; states are finite whatever the code.
"""

from __future__ import annotations

from typing import Any

from adaptsim_jax.core.registry import Registry
from adaptsim_jax.tasks.engine import Backend, EngineKind, own_settings
from adaptsim_jax.tasks.pushing.model import PAPER, PushOptions, check_options

HERE = "adaptsim_jax.tasks.pushing.engines"
BACKENDS: Registry[EngineKind] = Registry(
    "backends",
    {
        "native": f"{HERE}.native:ENGINE",
        "mjx": f"{HERE}.mjx:ENGINE",
        "planar": f"{HERE}.planar:ENGINE",
        "drake": f"{HERE}.drake:ENGINE",
    },
    within="pushing",
)


def make_backend(name: str, options: PushOptions = PAPER, /, **settings: Any) -> Backend:
    """A backend for `options`; BadInput where the name is unknown, the engine absent, or it cannot
    do the options or settings.

    `settings` are the engine's own, see `settings_of`; records may be given as tables.
    """
    kind = BACKENDS.named(name, "backend")
    return Backend(
        name, kind.make(check_options(options), *own_settings(name, kind.settings, settings))
    )


def settings_of(name: str) -> tuple[str, ...]:
    """What settings the engine called `name` has of its own."""
    return BACKENDS.named(name, "backend").settings._fields  # pyright: ignore[reportAttributeAccessIssue]
