"""Units of a log's columns: what may be written in `[units]`, and what makes each column SI."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.core.config import suggest
from adaptsim_jax.core.errors import BadInput, brief, finite
from adaptsim_jax.logs.columns import key_of

TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
ANGLE_UNITS = {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180, "rev": 2 * math.pi}
VELOCITY_UNITS = {
    "rad/s": 1.0,
    "mrad/s": 1e-3,
    "deg/s": math.pi / 180,
    "rev/s": 2 * math.pi,
    "rpm": 2 * math.pi / 60,
    "rad/ms": 1e3,
    "deg/ms": 1e3 * math.pi / 180,
}
TORQUE_UNITS = {
    "Nm": 1.0,
    "mNm": 1e-3,
    "Nmm": 1e-3,
    "Ncm": 1e-2,
    "kgfcm": 0.0980665,
    "kgcm": 0.0980665,
}
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
SPELT = key_of("units")
"""Units written out, as people do; `degrees/s` is read too."""
HINGE = {
    "q": "angle",
    "v": "velocity",
    "tau": "torque",
    "tau_commanded": "torque",
    "target": "angle",
}
SLIDE = {
    "q": "length",
    "v": "velocity",
    "tau": "force",
    "tau_commanded": "force",
    "target": "length",
}
INPUT = {"u": "voltage", "i": "current"}
"""Stem -> quantity, for joints that turn and joints that slide; `ctrl` goes to the actuator as it
is, but for `command_unit`.
"""
_EVERY = {unit: scale for table in QUANTITIES.values() for unit, scale in table.items()}
_FOLDED = {unit.casefold(): unit for unit in _EVERY}


@dataclass(frozen=True)
class Affine:
    """`si = scale * written + offset`: per cent of a range, encoder steps, a scale of one's own.

    `count`: What the encoder counts in a turn, None for none.
    """

    scale: float
    offset: float = 0.0
    count: float | None = None

    def of(self, written: np.ndarray) -> np.ndarray:
        """Convert values as written to SI units."""
        if self.offset:
            return written * self.scale + self.offset
        return written * self.scale


Unit = str | Affine
PERCENT = "percent"
"""Of the joint's range in the model, 0 to 100."""
FORMS = (
    "{percent = [LOW, HIGH]} (SI at 0 and at 100), {from = [-100, 100], to = [LOW, HIGH]}, {ticks "
    "= 4096, zero = 2048} or a number "
    "(SI a unit)"
)


def check_unit(path: Path, key: str, value: Any) -> Unit:
    """The unit that a line of `[units]` gives to the column, stem or quantity `key`; BadInput
    else.
    """
    if isinstance(value, dict) or (isinstance(value, int | float) and not isinstance(value, bool)):
        return _affine(path, key, value)
    if not isinstance(value, str):
        raise BadInput(f"{path}: units.{key} must be text in quotes, {FORMS}, not {brief(value)}")
    name = spelt(value)
    if name in (PERCENT, "%", "percents"):
        return PERCENT
    valid = QUANTITIES.get(key, _EVERY)
    if name not in valid:
        raise BadInput(
            f"{path}: units.{key} = {brief(value)} is unknown; {suggest(name, tuple(valid))}"
        )
    return name


def spelt(text: str) -> str:
    """A unit as the tables above spell it; what is none of them nearly as it was: `Degrees/sec` is
    `deg/s`, `N·m` is `Nm`.
    """
    plain_text = (
        re.sub(r"(?<=[a-z])\s*[.*·]?\s*s(?:\^?-1|⁻¹)$", "/s", text.strip())
        .replace("µ", "u")
        .replace("μ", "u")
    )
    words = "".join(c for c in plain_text if c not in " *.·").split("/")
    name = "/".join(SPELT.get(w, SPELT.get(w.casefold(), w)) for w in words)
    name = {"rev/min": "rpm"}.get(name, name)
    if name in _EVERY or len(name) == 1:
        return name
    return _FOLDED.get(name.casefold(), name)


def unit_of(text: str) -> str | None:
    """The unit that a text is, as the tables above spell it; None where it is none."""
    name = spelt(text) if text.strip() else ""
    if name in _EVERY:
        return name
    return None


def quantity_of(stem: str, slides: bool) -> str | None:
    """What is measured in a column of this stem; None for `ctrl`, whose unit is its actuator's, and
    for what has no unit.
    """
    if stem == "time":
        return "time"
    return INPUT.get(stem) or (SLIDE if slides else HINGE).get(stem)


def units_of(quantity: str | None, slides: bool) -> Mapping[str, float]:
    """Units that a column of a joint may be in, by what each is in SI.

    Args:
        quantity: By `quantity_of`, None for any.
    """
    if quantity is None:
        return _EVERY
    if quantity == "velocity":
        if slides:
            return SPEED_UNITS
        return VELOCITY_UNITS
    return QUANTITIES[quantity]


def si_of(quantity: str | None, slides: bool) -> str:
    """The SI unit of a quantity, as the tables above spell it; '' for none."""
    if quantity is None:
        return ""
    return next(name for name, scale in units_of(quantity, slides).items() if scale == 1.0)


def _affine(path: Path, key: str, value: Any) -> Affine:
    table = value if isinstance(value, dict) else {"scale": value}

    def pair(name):
        if isinstance(table[name], list) and len(table[name]) == 2:
            return [finite(x) for x in table[name]]
        return [None]

    def number_at(name, default):
        return finite(table.get(name, default))

    affine: Affine | None = None
    if (
        set(table) <= {"scale", "offset"}
        and (scale := number_at("scale", None))
        and (shift := number_at("offset", 0.0)) is not None
    ):
        affine = Affine(scale, shift)
    elif set(table) == {"percent"} and None not in (to := pair("percent")):
        affine = _between([0.0, 100.0], to)
    elif (
        set(table) == {"from", "to"}
        and None not in (ends := pair("from"))
        and None not in (to := pair("to"))
    ):
        affine = _between(ends, to)
    elif (
        set(table) <= {"ticks", "zero"}
        and (ticks := number_at("ticks", None))
        and (zero := number_at("zero", 0.0)) is not None
    ):
        affine = Affine(2.0 * math.pi / ticks, -2.0 * math.pi * zero / ticks, ticks)
    if affine is None or not math.isfinite(affine.scale) or affine.scale == 0.0:
        raise BadInput(
            f"{path}: units.{key} = {brief(value)} is no unit; write one in quotes, {FORMS}"
        )
    return affine


def _between(ends: list, to: list) -> Affine | None:
    if ends[0] == ends[1] or to[0] == to[1]:
        return None
    scale = (to[1] - to[0]) / (ends[1] - ends[0])
    return Affine(scale, to[0] - scale * ends[0])


def column_unit(
    where: str,
    units: Mapping[str, Unit],
    stem: str,
    words: tuple[str, ...],
    *,
    slides: bool,
    limits: tuple[float, float] | None = None,
) -> Affine:
    """What makes a column of quantity `stem` SI.

    A velocity, and a target, follow the angle of their joint unless they are declared. BadInput
    where the declared unit belongs to another quantity; `where` opens its message.

    Args:
        words: The names that `[units]` may give it, closest first.
        limits: The joint's range in the model, of which per cent are taken.
    """
    quantity = quantity_of(stem, slides)
    if quantity is None:
        return Affine(1.0)
    joint = _as_angle(stem, words)
    angle = (HINGE if not slides else SLIDE)["q"]
    name = declared(units, stem, words, slides=slides)
    rate = name is None and stem == "v"
    if rate:
        name = next((units[w] for w in (*joint, "q", angle) if w in units), None)
    if name is None:
        return Affine(1.0)
    if name == PERCENT:
        name = _of_range(where, words[0] if words else stem, limits)
    if isinstance(name, Affine):
        if rate or stem == "v":
            return Affine(name.scale)
        return name
    name = f"{name}/s" if rate else name
    if name not in QUANTITIES[quantity]:
        raise BadInput(
            f"{where} is in {name}, which is no unit of {quantity}; "
            f"{suggest(name, QUANTITIES[quantity])}"
        )
    return Affine(QUANTITIES[quantity][name])


def declared(
    units: Mapping[str, Unit], stem: str, words: tuple[str, ...], *, slides: bool
) -> Unit | None:
    """What `[units]` says of a column itself; None where nothing, though a velocity may follow its
    angle then (`column_unit`).
    """
    quantity = quantity_of(stem, slides)
    if quantity is None:
        return next(
            (units[word] for word in (*words, stem) if word.startswith(stem) and word in units),
            None,
        )
    # a target is in its angle's unit, whose own word is closer than that of all angles
    order = (*words, stem, *((*_as_angle(stem, words), "q") if stem == "target" else ()), quantity)
    return next(
        (units[word] for word in order if word in units and _fits(units, word, quantity)), None
    )


def command_unit(where: str, units: Mapping[str, Unit], words: tuple[str, ...]) -> Affine:
    """What makes a column `ctrl` what its actuator takes: as it is, but where `[units]` names this
    column, or `ctrl` for all.
    """
    name = declared(units, "ctrl", words, slides=False)
    if name == PERCENT:
        name = _of_range(where, words[0], None)
    if isinstance(name, Affine):
        return name
    return Affine(1.0 if name is None else _EVERY[name])


def _as_angle(stem: str, words: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(word.replace(stem, "q", 1) for word in words if word.startswith(stem))


def _of_range(where: str, word: str, limits: tuple[float, float] | None) -> Affine:
    affine = _between([0.0, 100.0], list(limits)) if limits else None
    if affine is None:
        raise BadInput(
            f"{where} is in per cent of a range that the model does not declare; write {word} = "
            f"{{percent = [LOW, HIGH]}}, what 0 and 100 are in rad or m, under [units]"
        )
    return affine


def _fits(units: Mapping[str, Unit], word: str, quantity: str) -> bool:
    # a stem speaks for turning and sliding joints alike: `q = "deg"` is not meant for the cart
    if word not in ("q", "v", "tau", "target", "velocity") or not isinstance(units[word], str):
        return True
    return units[word] == PERCENT or units[word] in QUANTITIES[quantity]
