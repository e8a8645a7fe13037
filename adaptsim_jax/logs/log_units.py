"""Units of a log's columns: what may be written in `[units]`, and the scale that makes each column SI."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from adaptsim_jax.core.config import suggest
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.given import brief
from adaptsim_jax.logs.meta import ANGLE_UNITS, SPELLED, TIME_UNITS, TORQUE_UNITS, VELOCITY_UNITS

LENGTH_UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
SPEED_UNITS = {f"{name}/s": scale for name, scale in LENGTH_UNITS.items()}
FORCE_UNITS = {"N": 1.0, "mN": 1e-3, "kN": 1e3}
VOLT_UNITS = {"V": 1.0, "mV": 1e-3}
AMPERE_UNITS = {"A": 1.0, "mA": 1e-3}
QUANTITIES = {
    "time": TIME_UNITS,
    "angle": ANGLE_UNITS,
    "velocity": VELOCITY_UNITS | SPEED_UNITS,
    "torque": TORQUE_UNITS,
    "length": LENGTH_UNITS,
    "force": FORCE_UNITS,
    "voltage": VOLT_UNITS,
    "current": AMPERE_UNITS,
}
SPELT = SPELLED | {"meters": "m", "millimeters": "mm", "metres": "m", "millimetres": "mm", "volts": "V", "amperes": "A"}
HINGE = {"q": "angle", "v": "velocity", "tau": "torque", "tau_commanded": "torque", "target": "angle"}
SLIDE = {"q": "length", "v": "velocity", "tau": "force", "tau_commanded": "force", "target": "length"}
INPUT = {"u": "voltage", "i": "current"}
"""Stem -> quantity, for joints that turn and joints that slide; `ctrl` goes to the actuator as it is."""


def check_unit(path: Path, key: str, value: Any) -> str:
    """The short name of the unit that a line of `[units]` gives to the column, stem or quantity `key`; BadInput else."""
    if not isinstance(value, str):
        raise BadInput(f"{path}: units.{key} must be text in quotes, not {brief(value)}")
    words = "".join(c for c in value if c not in " *.·").split("/")
    name = "/".join(SPELT.get(w, w) for w in words)
    every = {unit: None for table in QUANTITIES.values() for unit in table}
    known = QUANTITIES.get(key, every)
    if name not in known:
        raise BadInput(f"{path}: units.{key} = {brief(value)} is unknown; {suggest(name, tuple(known))}")
    return name


def column_scale(where: str, units: Mapping[str, str], stem: str, words: tuple[str, ...], *, slides: bool) -> float:
    """`si = scale * written` of a column of quantity `stem`; `words`: the names that `[units]` may give it, closest first.

    A velocity, and a target, follow the angle of their joint unless they are declared. BadInput where the declared unit
    belongs to another quantity; `where` opens its message.
    """
    quantity = "time" if stem == "time" else INPUT.get(stem) or (SLIDE if slides else HINGE).get(stem)
    if quantity is None:
        return 1.0
    name = next(
        (units[word] for word in (*words, stem, quantity) if word in units and _fits(units, word, quantity)), None
    )
    if name is None and stem in ("v", "target"):
        joint = tuple(word.replace(stem, "q", 1) for word in words if word.startswith(stem))
        angle = next((units[w] for w in (*joint, "q", (SLIDE if slides else HINGE)["q"]) if w in units), None)
        name = f"{angle}/s" if angle and stem == "v" else angle
    if name is None:
        return 1.0
    if name not in QUANTITIES[quantity]:
        raise BadInput(f"{where} is in {name}, which is no unit of {quantity}; {suggest(name, QUANTITIES[quantity])}")
    return QUANTITIES[quantity][name]


def _fits(units: Mapping[str, str], word: str, quantity: str) -> bool:
    # a stem speaks for turning and sliding joints alike: `q = "deg"` is not meant for the cart
    return word not in ("q", "v", "tau", "target", "velocity") or units[word] in QUANTITIES[quantity]
