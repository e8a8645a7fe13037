"""The one signature of all physics backends: same scene, same parameters, same trajectory type."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

from adaptsim_jax.core import config
from adaptsim_jax.core.errors import BadInput

Array = Any
S = TypeVar("S")


class Trajectory(NamedTuple):
    """`state: [B, T, S]` (positions, then velocities; rad, rad/s) after each command row.

    `code: [B]` is 0, or 1 where the motion ceased to be finite.
    """

    state: Array
    code: Array


class EngineKind(NamedTuple):
    """An engine as a registry of backends holds it: `make(options, *settings) -> simulate`, of
    `Backend`.

    options: the task's own (`PushOptions`, `ScoopOptions`; of the pendulum its step [s]). settings:
    a NamedTuple of what is the engine's alone, with defaults. `make` raises BadInput where the
    engine is absent or cannot do the options.
    """

    settings: type
    make: Callable[..., Callable[[Array, Array, Array], Trajectory]]


class NoSettings(NamedTuple):
    """Of an engine that has none of its own."""


class Backend(NamedTuple):
    """`simulate(params [B, P], commands [B, T, U], initial [B, S]) -> Trajectory`, rows held for a
    step.
    """

    name: str
    simulate: Callable[[Array, Array, Array], Trajectory]


def own_settings(engine: str, kind: type[S], settings: dict[str, Any]) -> S:
    """An engine's own `settings` as its record `kind`, whose defaults stand for what is left out;
    tables become records.

    BadInput names an unknown key or a value of another type.
    """
    made = config.from_table(kind, settings, f"backend {engine}")
    for name in ("threads", "batch"):
        count = getattr(made, name, None)
        if count is not None and count < 1:
            raise BadInput(f"backend {engine}, {name} = {count}: give at least 1, or leave it out")
    return made
