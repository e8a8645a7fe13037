"""The catalogue of effects by name: ours in this order, then those of other packages (entry points
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

HERE = "adaptsim_jax.effects"
STAND = (
    "joints.friction:COULOMB",
    "joints.friction:STRIBECK",
    "joints.friction:QUADRATIC_DRAG",
    "elastic:SPRING",
    "disturbance:BIAS",
    "disturbance:COGGING",
    "joints.friction:FRICTION_DRIFT",
    "disturbance:PERIODIC_DISTURBANCE",
    "elastic:HARD_STOP",
    "joints.friction:LOAD_FRICTION",
    "joints.friction:PRESLIDING",
    "joints.actuator:ROTOR_INERTIA",
    "disturbance:TILT",
    "disturbance:HEAVE",
    "disturbance:SWAY",
    "joints.actuator:DELAY",
    "joints.actuator:SATURATION",
    "joints.actuator:DEAD_ZONE",
    "joints.actuator:TORQUE_GAIN",
    "joints.actuator:ACTUATOR_LAG",
    "joints.sensor:ENCODER_OFFSET",
    "joints.sensor:SENSOR_LAG",
    "joints.sensor:BACKLASH",
)
"""File and name of each effect of the double pendulum; its constant is `PENDULUM_` and the name."""
EFFECTS: Registry[Effect] = Registry(
    "effects",
    type="Effect",
    own={
        name.lower(): f"{HERE}.{file}:PENDULUM_{name}"
        for file, _, name in (text.partition(":") for text in STAND)
    },
)
ALSO = {
    "mechanism": "adaptsim_jax.effects.joints.catalogue:MACHINE",
    "pushing": "adaptsim_jax.tasks.pushing.diagnosis.catalogue:EFFECTS",
    "scooping": "adaptsim_jax.tasks.scooping.diagnosis.catalogue:EFFECTS",
    "toss": "adaptsim_jax.tasks.toss.catalogue:EFFECTS",
}
"""Where the catalogues of other tasks stand, which are loaded when asked for."""


def catalogue(task: str = "pendulum") -> tuple[Any, ...]:
    """What `diagnose` can find in recordings of a task.

    Args:
        task: `mechanism` (any tree of joints), `pushing`, `scooping`, `toss`; `pendulum`: the
            effects that a `model.toml` of the double pendulum may hold, in which policies are
            trained.

    Returns:
        Effects, ours first, then those of other packages (entry points `adaptsim.effects`). Add
        your own to it: `catalogue("mechanism") + (my_effect,)`. Raises BadInput where there is no
        such task.
    """
    if task == "pendulum":
        return tuple(EFFECTS.values())
    if task not in ALSO:
        raise BadInput(f"task {task!r} is unknown; use one of pendulum, {', '.join(ALSO)}")
    return tuple(EntryPoint(task, ALSO[task], EFFECTS.group).load())


def of_other_packages(taken: Sequence[str] = ()) -> tuple[Effect, ...]:
    """Effects that other packages add, by name: one registration serves every machine. Those with a
    memory of their own only the pendulum's simulator steps. Raises BadInput where one has a name of
    those `taken`.
    """
    if both := sorted(set(taken) & set(EFFECTS.others)):
        point = EFFECTS.others[both[0]]
        raise BadInput(
            f"entry point {point.name} = {point.value} of {EFFECTS.group}: there is another of "
            "that name; rename it"
        )
    found = [with_function(EFFECTS[name]) for name in EFFECTS.others]
    return tuple(e for e in found if not e.memory)


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
    """Effects of the double pendulum and of any machine by name, for words about them."""
    return {e.name: e for task in ("pendulum", "mechanism") for e in catalogue(task)}


def effect_named(name: str, effects: tuple[Effect, ...]) -> Effect:
    """The effect of that name; raises BadInput that lists those there are."""
    found: Mapping[str, Effect] = {e.name: e for e in effects}
    if name not in found:
        raise BadInput(f"effect {name!r} is unknown; use one of {', '.join(found)}")
    return found[name]
