"""What a camera may do to tracks of trials, whatever the task: quantities, effects, and the view
itself. And how the catalogue of a task's trials is written.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax.numpy as jnp

from adaptsim_jax.effects.base import Effect, Quantity, of_the_engine

Array = Any


def quantity(
    name: str,
    unit: str,
    low: float,
    high: float,
    scale: float,
    default: float = 0.0,
    mjcf: str = "",
) -> Quantity:
    """A quantity of an effect, with a prior as wide as twice its farther bound."""
    prior = 2.0 * max(abs(low), abs(high))
    return Quantity(name, unit, low, high, default, prior=prior, mjcf=mjcf, scale=scale)


def effect_of(quantities: Sequence[Quantity]) -> Callable[..., Effect]:
    """What makes effects of a table of quantities: `(name, place, names of its quantities, physics,
    excitation, ...)`.
    """
    known = {q.name: q for q in quantities}

    def make(name, place, names, *words, **more) -> Effect:
        return Effect(name, place, tuple(known[n] for n in names), of_the_engine, *words, **more)

    return make


QUANTITIES = (
    quantity("shift_x", "m", -0.1, 0.1, 0.002),
    quantity("shift_y", "m", -0.1, 0.1, 0.002),
    quantity("scale", "", -0.2, 0.2, 0.01),
    quantity("turn", "rad", -0.25, 0.25, 0.01),
    quantity("latency", "s", -0.1, 0.2, 0.005),
    quantity("clock", "", -0.2, 0.2, 0.01),
    quantity("near", "1/m", 0.0, 2.0, 0.05),
    quantity("lean_x", "", -1.0, 1.0, 0.02),
    quantity("lean_y", "", -1.0, 1.0, 0.02),
)
"""`near`: one over a camera's height; `lean_x`, `lean_y`: the point under it over its height. All
0: a far camera that looks down.
"""


def effects(trial: str, origin: str, rises: bool) -> tuple[Effect, ...]:
    """The effects on tracks of a `trial`, in a frame about `origin`. rises: Whether heights vary.

    A late start of the arm shifts all of a track in time, as a latency does: no trial tells them
    apart, only the arm's own log.
    """
    observed, effect = f"any {trial}", effect_of(QUANTITIES)

    def make(name, names, physics, **more):
        return effect(name, "measurement", names, physics, observed, **more)

    return (
        make("camera_shift", ("shift_x", "shift_y"), "the camera's frame lies beside the arm's"),
        make(
            "camera_scale", ("scale",), f"lengths are measured too long or too short, from {origin}"
        ),
        make("camera_turn", ("turn",), f"the camera is turned about {origin}"),
        make(
            "latency",
            ("latency",),
            "tracks are told later than they happen",
            same=("late_start@command",),
            separated_by="a log of the arm by the camera's clock",
        ),
        make("clock_scale", ("clock",), "the camera's clock runs fast or slow"),
        make(
            "parallax",
            ("near", "lean_x", "lean_y"),
            "what is above the table is seen farther from the point under the camera",
            same=() if rises else ("camera_scale_with_shift@measurement",),
            separated_by="the camera's height and place",
        ),
    )


def happened(v: Mapping[str, Array], time: Array) -> Array:
    """When it happened what the camera's clock tells at `time [R]` s."""
    return (1.0 + v["clock"]) * time - v["latency"]


def turned(xy: Array, angle: Array) -> Array:
    """Points `[R, 2]` turned by `angle` rad."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    x, y = xy[:, 0], xy[:, 1]
    return jnp.stack([c * x - s * y, s * x + c * y], 1)


def viewed(v: Mapping[str, Array], xy: Array, height: Array) -> Array:
    """Places `[R, 2]` m, at `height` m (a number or `[R, 1]`) above the table, as the camera tells
    them.
    """
    beyond = v["near"] * xy - jnp.stack([v["lean_x"], v["lean_y"]])[None]
    xy = xy + height / (1.0 - height * v["near"]) * beyond
    return (1.0 + v["scale"]) * turned(xy, v["turn"]) + jnp.stack([v["shift_x"], v["shift_y"]])[
        None
    ]
