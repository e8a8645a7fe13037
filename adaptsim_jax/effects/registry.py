"""The catalogue of effects by name: ours in this order, then those of other packages (entry points
`adaptsim.effects`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.metadata import EntryPoint
from typing import TYPE_CHECKING, Any

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.registry import Registry

if TYPE_CHECKING:
    from adaptsim_jax.effects.base import Effect

HERE = "adaptsim_jax.effects"
EFFECTS: Registry[Effect] = Registry(
    "effects",
    type="Effect",
    own={
        "coulomb": f"{HERE}.friction:COULOMB",
        "stribeck": f"{HERE}.friction:STRIBECK",
        "quadratic_drag": f"{HERE}.friction:QUADRATIC_DRAG",
        "spring": f"{HERE}.elastic:SPRING",
        "bias": f"{HERE}.disturbance:BIAS",
        "cogging": f"{HERE}.disturbance:COGGING",
        "friction_drift": f"{HERE}.friction:FRICTION_DRIFT",
        "periodic_disturbance": f"{HERE}.disturbance:PERIODIC_DISTURBANCE",
        "hard_stop": f"{HERE}.elastic:HARD_STOP",
        "load_friction": f"{HERE}.friction:LOAD_FRICTION",
        "presliding": f"{HERE}.friction:PRESLIDING",
        "rotor_inertia": f"{HERE}.inertia:ROTOR_INERTIA",
        "tilt": f"{HERE}.base_motion:TILT",
        "heave": f"{HERE}.base_motion:HEAVE",
        "sway": f"{HERE}.base_motion:SWAY",
        "delay": f"{HERE}.actuator:DELAY",
        "saturation": f"{HERE}.actuator:SATURATION",
        "dead_zone": f"{HERE}.actuator:DEAD_ZONE",
        "torque_gain": f"{HERE}.actuator:TORQUE_GAIN",
        "actuator_lag": f"{HERE}.actuator:ACTUATOR_LAG",
        "encoder_offset": f"{HERE}.sensor:ENCODER_OFFSET",
        "sensor_lag": f"{HERE}.sensor:SENSOR_LAG",
        "backlash": f"{HERE}.sensor:BACKLASH",
    },
)
ALSO = {
    "mechanism": "adaptsim_jax.attribution.catalogue:MACHINE",
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
            f"that name; rename it"
        )
    found = [EFFECTS[name] for name in EFFECTS.others]
    return tuple(e for e in found if not e.memory)


def effect_named(name: str, effects: tuple[Effect, ...]) -> Effect:
    """The effect of that name; raises BadInput that lists those there are."""
    found: Mapping[str, Effect] = {e.name: e for e in effects}
    if name not in found:
        raise BadInput(f"effect {name!r} is unknown; use one of {', '.join(found)}")
    return found[name]
