"""The catalogues of effects by task, and the effects of other packages (entry points
`adaptsim.effects`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from importlib.metadata import EntryPoint
from typing import TYPE_CHECKING, Any

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.registry import Registry

if TYPE_CHECKING:
    from adaptsim_jax.effects.base import Effect

EFFECTS: Registry[Effect] = Registry("effects", type="Effect", own={})
MACHINES = "adaptsim_jax.effects.joints.catalogue:MACHINE"
CATALOGUES = {
    "mechanism": MACHINES,
    "pendulum": MACHINES,
    "pushing": "adaptsim_jax.tasks.pushing.diagnosis.catalogue:EFFECTS",
    "scooping": "adaptsim_jax.tasks.scooping.diagnosis.catalogue:EFFECTS",
    "toss": "adaptsim_jax.tasks.toss.catalogue:EFFECTS",
}
"""Where the catalogues of tasks stand, which are loaded when asked for."""


def catalogue(task: str = "mechanism") -> tuple[Any, ...]:
    """What `diagnose` can find in recordings of a task.

    Args:
        task: `mechanism` (any tree of joints) or `pendulum`, which is one, `pushing`, `scooping`,
            `toss`.

    Returns:
        Effects, ours first, then those of other packages (entry points `adaptsim.effects`). Add
        your own to it: `catalogue("mechanism") + (my_effect,)`. Raises BadInput where there is no
        such task.
    """
    if task not in CATALOGUES:
        raise BadInput(f"task {task!r} is unknown; use one of {', '.join(CATALOGUES)}")
    return tuple(EntryPoint(task, CATALOGUES[task], EFFECTS.group).load())


def of_other_packages(taken: Sequence[str] = ()) -> tuple[Effect, ...]:
    """Effects that other packages add, by name: one registration serves every machine. Raises
    BadInput where one has a name of those `taken`.
    """
    if both := sorted(set(taken) & set(EFFECTS.others)):
        point = EFFECTS.others[both[0]]
        raise BadInput(
            f"entry point {point.name} = {point.value} of {EFFECTS.group}: there is another of "
            "that name; rename it"
        )
    return tuple(with_function(EFFECTS[name]) for name in EFFECTS.others)


def with_function(effect: Effect) -> Effect:
    """An effect that another package adds to machines; raises BadInput where it has no function."""
    from adaptsim_jax.effects.base import of_the_engine

    if effect.apply is of_the_engine:
        raise BadInput(
            f"effect {effect.name}: it has no function; give apply, which says what it does to a "
            f"{effect.place} (adaptsim new effect NAME writes one to start from)"
        )
    return effect


@cache
def of_joints() -> dict[str, Effect]:
    """Effects of any machine by name, for words about them."""
    return {e.name: e for e in catalogue("mechanism")}


def effect_named(name: str, effects: tuple[Effect, ...]) -> Effect:
    """The effect of that name; raises BadInput that lists those there are."""
    found: Mapping[str, Effect] = {e.name: e for e in effects}
    if name not in found:
        raise BadInput(f"effect {name!r} is unknown; use one of {', '.join(found)}")
    return found[name]
