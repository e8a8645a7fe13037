"""What the heading of a column says beside its name: the unit, as in `q1 [deg]`, `Elbow Position
(deg)`, `elbow_vel_deg_s`, `t_ms`.

A heading is read here once, for `adaptsim init`, which writes what it says into `[units]`, and for
every reader, which tells where that is not what is declared.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.columns import Role, role
from adaptsim_jax.logs.criteria import UNIT
from adaptsim_jax.logs.log_units import (
    Affine,
    Unit,
    declared,
    quantity_of,
    si_of,
    unit_of,
    units_of,
)

_BRACKETS = re.compile(r"\s*[\[({]([^\[\](){}]*)[\])}]")
_SEPARATORS = re.compile(r"[\s_./-]+")
_SECONDS = ("s", "sec", "second")


@dataclass(frozen=True)
class Heading:
    """`name`: what is written without its unit; `unit`: as `log_units` spells it, None where the
    heading says none.
    """

    name: str
    unit: str | None = None


@dataclass(frozen=True)
class HeadingUnit:
    """What a heading says of the unit of a column.

    - `column`: Our name of it.
    - `quantity`: None for commands of actuators.
    - `fits`: Whether a column of this quantity may be in this `unit`.
    - `slides`: Whether its joint does.
    """

    column: str
    heading: str
    unit: str
    quantity: str | None
    slides: bool

    @property
    def fits(self) -> bool:
        return self.unit in units_of(self.quantity, self.slides)

    @property
    def scale(self) -> float:
        """SI of one of this unit."""
        return units_of(self.quantity, self.slides)[self.unit]


def heading(written: str, joints: Iterable[str] = ()) -> Heading:
    """A column's heading as its file writes it.

    Args:
        joints: The model's, where known. A joint's own name has no unit in it.
    """
    joints = tuple(joints)
    column_role = role(written, joints)
    if column_role is not None and column_role.joint in joints:
        return Heading(written)
    for match in reversed(list(_BRACKETS.finditer(written))):
        name = (written[: match.start()] + written[match.end() :]).strip(" _")
        if name and match[1] not in joints and (unit := unit_of(match[1])):
            return Heading(name, unit)
    number = re.search(r"(?<=[A-Za-z])[\s_.]?\d+$", written)  # `pos_deg_1` is `pos_1` in degrees
    if number:
        stem, number_text = (written[: number.start()], number[0])
    else:
        stem, number_text = ("", "")
    if match := _suffix(written, joints):
        return match
    match = _suffix(stem, joints)
    if match:
        return Heading(match.name + number_text, match.unit)
    return Heading(written)


def _suffix(written: str, joints: tuple[str, ...]) -> Heading | None:
    """The unit that a heading ends in after a separator."""
    starts = [match.end() for match in _SEPARATORS.finditer(written)]
    for count in range(min(3, len(starts)), 0, -1):
        words = _SEPARATORS.split(written[starts[-count] :])
        name = written[: starts[-count]].rstrip(" _./-")
        unit = unit_of(_joined(words))
        if (
            unit
            and name
            and (len(words[0]) > 1 or count > 1 or _letter(name, unit, written, joints))
        ):
            return Heading(name, unit)
    return None


def _joined(words: Sequence[str]) -> str:
    """`rad s` and `rad per s` are rad/s, `N m` is a torque; other words in a row are no unit."""
    if words[-1] in _SECONDS and (len(words) == 2 or (len(words) == 3 and words[1] == "per")):
        return f"{words[0]}/s"
    if len(words) == 1 or (len(words) == 2 and words[0] in ("N", "mN")):
        return "".join(words)
    return ""


def _letter(name: str, unit: str, written: str, joints: tuple[str, ...]) -> bool:
    """Whether one letter at the end is a unit (`i1_A`), not the name of a joint (`position_A`)."""
    column_role = role(name, joints)
    if column_role is None or (not joints and role(written) is not None):
        return False
    return any(
        unit in units_of(quantity_of(column_role.stem, slides), slides) for slides in (False, True)
    )


def heading_unit(
    column: str, written: str, column_role: Role, slides: bool | None, joints: Sequence[str] = ()
) -> HeadingUnit | None:
    """What the heading `written` of our `column` says of its unit; None where nothing.

    Args:
        slides: None where the joint is not known.
    """
    unit = heading(written, joints).unit
    if unit is None or column_role.stem in ("trial", "base", "channel"):
        return None
    if slides is None:
        fits_turn, fits_slide = (
            unit in units_of(quantity_of(column_role.stem, kind), kind) for kind in (False, True)
        )
        slides = fits_slide and not fits_turn
    return HeadingUnit(column, written, unit, quantity_of(column_role.stem, slides), slides)


def lines(found: Sequence[HeadingUnit]) -> dict[str, HeadingUnit]:
    """The lines of `[units]` that headings come to: one for a quantity where they agree, else one
    for each column.
    """
    out: dict[str, HeadingUnit] = {}
    velocity_kinds = {s.slides for s in found if s.quantity == "velocity"}
    for row in (s for s in found if s.fits):
        units = {s.unit for s in found if s.fits and s.quantity == row.quantity}
        general = (
            row.quantity is not None
            and len(units) == 1
            and (row.quantity != "velocity" or len(velocity_kinds) == 1)
        )
        out.setdefault(str(row.quantity) if general else row.column, row)
    return out


def check_headings(
    path: str,
    headings: Sequence[tuple[HeadingUnit, Affine, tuple[str, ...], str]],
    units: Mapping[str, Unit],
) -> tuple[str, ...]:
    """Notes on columns whose headings say another unit than the declared one.

    Raises `BadInput` where nothing is declared and the heading says no SI unit.

    Args:
        headings: Of each column what its heading says, what it is read in, its words in `[units]`,
            its stem.
    """
    notes: list[str] = []
    undeclared: list[HeadingUnit] = []
    for row, unit, words, stem in headings:
        declared_unit = declared(units, stem, words, slides=row.slides)
        if not row.fits:
            if declared_unit:
                notes += []
            else:
                notes += [
                    f"the heading {row.heading!r} says {row.unit}, no unit of {row.quantity}: not "
                    "taken"
                ]
        elif unit.offset or abs(unit.scale / row.scale - 1.0) > UNIT.scale_tolerance:
            if declared_unit is None:
                undeclared.append(row)
            elif isinstance(declared_unit, str):
                notes.append(
                    f"column {row.heading!r} is read in {declared_unit}, as declared; its heading "
                    f"says {row.unit}"
                )
    if not undeclared:
        return tuple(notes)
    all_lines = lines([row for row, *_ in headings])
    mend = {
        key: row
        for key, row in all_lines.items()
        if any(key in (o.quantity, o.column) for o in undeclared)
    }
    other = ((key, si_of(row.quantity, row.slides)) for key, row in mend.items())
    text = " and ".join(f'{key} = "{row.unit}"' for key, row in mend.items())
    otherwise = " and ".join(f'{key} = "{name}"' if name else f"{key} = 1.0" for key, name in other)
    raise BadInput(
        f"{path}: the heading {undeclared[0].heading!r} says {undeclared[0].unit}, and no unit is "
        "declared for "
        f"it; write {text} under [units] in meta.toml, or {otherwise} if the heading is wrong"
    )
