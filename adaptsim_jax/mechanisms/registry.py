"""Models of a recording by name: what `model = "rigid_body"` in meta.toml stands for. Imports no
JAX.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from adaptsim_jax.core.registry import Registry

if TYPE_CHECKING:
    from adaptsim_jax.mechanisms.plant import Plant

HERE = "adaptsim_jax.mechanisms.double_pendulum.plant"
MECHANISMS: Registry[Callable[[str, Mapping[str, float], Mapping[str, float]], Plant]] = Registry(
    "mechanisms",
    {"linearized": f"{HERE}:linearized_pendulum", "rigid_body": f"{HERE}:rigid_pendulum"},
)


def make_plant(
    model: str,
    angle_zero: str,
    geometry: Mapping[str, float],
    known: Mapping[str, float] | None = None,
) -> Plant:
    """The plant called `model`, as `angle_zero`, `[geometry]` and `[known]` of meta.toml say.
    BadInput where it is unknown or cannot be made of these.
    """
    return MECHANISMS.named(model, "meta.toml: model")(angle_zero, geometry, dict(known or {}))
