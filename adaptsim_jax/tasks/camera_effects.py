"""What a camera may do to tracks of trials, whatever the task: quantities, effects, and the view
itself. And how the catalogue of a task's trials is written.
"""

import itertools
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp

from adaptsim_jax.core import config
from adaptsim_jax.core.config import Table
from adaptsim_jax.effects.base import Effect, Quantity

Array = Any


def read_table(path: Path) -> tuple[tuple[Quantity, ...], dict[str, Table]]:
    """The quantities of a catalogue's file, and its table of effects. A prior is as wide as twice
    the farther bound where the file does not say it.
    """
    table = config.read(path)
    quantities = []
    for name, row in table["quantities"].items():
        prior = 2.0 * max(abs(row["low"]), abs(row["high"]))
        quantities.append(Quantity(**{"name": name, "prior": prior} | row))
    return tuple(quantities), table["effects"]


def effects_of(table: dict[str, Table], quantities: Iterable[Quantity]) -> tuple[Effect, ...]:
    """The effects of a catalogue's file, of these `quantities`. A grid is all combinations of the
    values that it names.
    """
    known, effects = {q.name: q for q in quantities}, []
    for name, row in table.items():
        texts: Table = {k: tuple(v) if isinstance(v, list) else v for k, v in row.items()}
        own = tuple(known[n] for n in texts.pop("parameters"))
        grid = texts.pop("grid", None)
        if grid is not None:
            grid = tuple(
                dict(zip(grid, values, strict=True)) for values in itertools.product(*grid.values())
            )
        effects.append(Effect(name, parameters=own, grid=grid, **texts))
    return tuple(effects)


QUANTITIES, _EFFECTS = read_table(Path(__file__).with_suffix(".toml"))


def effects(trial: str, origin: str, rises: bool) -> tuple[Effect, ...]:
    """The effects on tracks of a `trial`, in a frame about `origin`. rises: Whether heights vary,
    which tells a parallax from lengths that are off.
    """
    made = []
    for effect in effects_of(_EFFECTS, QUANTITIES):
        physics, seen = (
            text.format(trial=trial, origin=origin) for text in (effect.physics, effect.excitation)
        )
        same = () if rises and effect.name == "parallax" else effect.same
        made.append(replace(effect, physics=physics, excitation=seen, same=same))
    return tuple(made)


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
