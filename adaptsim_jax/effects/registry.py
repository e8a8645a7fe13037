"""The catalogue of effects by name."""

from collections.abc import Mapping

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.effects.actuator import COMMAND
from adaptsim_jax.effects.base import Effect
from adaptsim_jax.effects.base_motion import BASE
from adaptsim_jax.effects.force import FORCE
from adaptsim_jax.effects.sensor import MEASUREMENT


def catalogue(task: str = "pendulum") -> tuple[Effect, ...]:
    """Every effect known for a task. Add your own: `catalogue("pendulum") + (my_effect,)`."""
    if task not in ("pendulum", "pushing", "scooping"):
        raise BadInput(f"task {task!r} is unknown; use pendulum, pushing or scooping")
    return FORCE + BASE + COMMAND + MEASUREMENT


def effect_named(name: str, effects: tuple[Effect, ...]) -> Effect:
    """The effect of that name; raises BadInput that lists those there are."""
    found: Mapping[str, Effect] = {e.name: e for e in effects}
    if name not in found:
        raise BadInput(f"effect {name!r} is unknown; use one of {', '.join(found)}")
    return found[name]
