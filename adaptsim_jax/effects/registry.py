"""The catalogue of effects by name: ours in this order, then those of other packages (entry points `adaptsim.effects`)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

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
TASKS = ("pendulum", "pushing", "scooping")  # of which recordings may be diagnosed with it


def catalogue(task: str = "pendulum") -> tuple[Effect, ...]:
    """Every effect known for a task. Add your own: `catalogue("pendulum") + (my_effect,)`."""
    if task not in TASKS:
        raise BadInput(f"task {task!r} is unknown; use pendulum, pushing or scooping")
    return tuple(EFFECTS.values())


def effect_named(name: str, effects: tuple[Effect, ...]) -> Effect:
    """The effect of that name; raises BadInput that lists those there are."""
    found: Mapping[str, Effect] = {e.name: e for e in effects}
    if name not in found:
        raise BadInput(f"effect {name!r} is unknown; use one of {', '.join(found)}")
    return found[name]
