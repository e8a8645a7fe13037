"""The one signature of all physics backends: same scene, same parameters, same trajectory type."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

Array = Any


class Trajectory(NamedTuple):
    """`state: [B, T, S]` (positions, then velocities; rad, rad/s) after each command row.

    `code: [B]` is 0, or 1 where the motion ceased to be finite.
    """

    state: Array
    code: Array


class Backend(NamedTuple):
    """`simulate(params [B, P], commands [B, T, U], initial [B, S]) -> Trajectory`, rows held for a step."""

    name: str
    simulate: Callable[[Array, Array, Array], Trajectory]
