"""The catalogue of effects, and a model's choice of them as one flat vector (`Layout`). What an
effect is: `base.py`.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.effects.base import Effect


class Instance(NamedTuple):
    """An effect at a place of the mechanism: `where` is `joint1`, ... or `base`; `at`: its part of
    the flat vector.
    """

    effect: Effect
    where: str
    joint: int
    at: slice


@dataclass(frozen=True)
class Layout:
    """All instances of some effects on `joints`, and their parameters as one flat vector `[E]`."""

    effects: tuple[Effect, ...]
    joints: tuple[str, ...]
    instances: tuple[Instance, ...] = field(init=False, compare=False)
    _starts: dict[str, int] = field(init=False, compare=False, repr=False)

    def __post_init__(self):
        found, starts, at = [], {}, 0
        for effect in self.effects:
            starts[effect.name] = at
            for i, where in enumerate(self.joints if effect.scope == "joint" else ("base",)):
                size = len(effect.parameters)
                found.append(Instance(effect, where, i, slice(at, at + size)))
                at += size
        object.__setattr__(self, "instances", tuple(found))
        object.__setattr__(self, "_starts", starts)

    @property
    def size(self) -> int:
        if self.instances:
            return self.instances[-1].at.stop
        return 0

    def index(self, name: str, where: str) -> int:
        """Number of an instance; raises BadInput if there is none."""
        for i, instance in enumerate(self.instances):
            if (instance.effect.name, instance.where) == (name, where):
                return i
        raise BadInput(
            f"effect {name!r} at {where!r} is not in the catalogue; `adaptsim effects` lists what "
            "is"
        )

    def off(self) -> np.ndarray:
        """`[E]`: every parameter at its default, where no effect acts."""
        every = (p for i in self.instances for p in i.effect.parameters)
        return np.array([p.default for p in every], float)

    def names(self) -> list[tuple[str, str, str]]:
        """(effect, where, parameter) of each entry of the vector."""
        return [
            (i.effect.name, i.where, p.name) for i in self.instances for p in i.effect.parameters
        ]

    def params(self, effect: Effect, eff: jax.Array, trailing: int) -> dict[str, jax.Array]:
        """`{name: [n, 1, ...]}` of one effect for all joints, with `trailing` axes to broadcast
        over.
        """
        rows = len(self.joints) if effect.scope == "joint" else 1
        at, width = self._starts[effect.name], len(effect.parameters)
        block = eff[at : at + rows * width].reshape((rows, width) + (1,) * trailing)
        return {p.name: block[:, k] for k, p in enumerate(effect.parameters)}

    def placed(self, place: str) -> Iterator[Effect]:
        return (e for e in self.effects if e.place == place)
