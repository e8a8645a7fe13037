"""A `meta.toml` guessed from the data: which column is what, in which units (`unit_guess`). Every
guess is marked as one.

Nothing here decides anything for good: a person reads the text, mends it, and takes the marks away.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.core.config import dumps, nearest
from adaptsim_jax.logs.columns import SPELLINGS, TIME, key_of, role
from adaptsim_jax.logs.headings import Heading, heading
from adaptsim_jax.logs.log import ModelNames
from adaptsim_jax.logs.log_units import quantity_of, units_of
from adaptsim_jax.logs.scales import Scale
from adaptsim_jax.logs.unit_guess import Question, Units, guess_units

WORDS = key_of("stems") | key_of("guesses")
STEM_OF_UNIT = {
    unit: stem
    for stem in ("q", "v", "tau", "u", "i")
    for slides in (False, True)
    for unit in units_of(quantity_of(stem, slides), slides)
}
TARGETS = {word for word, stem in WORDS.items() if stem == "target"}


@dataclass(frozen=True)
class Guess:
    """What the columns of a trial seem to be.

    - `columns`: Our name -> the file's, those that need it.
    - `units`: See `unit_guess.guess_units`.
    - `ignored`: Columns.
    """

    columns: dict[str, str]
    units: Units
    ignored: tuple[str, ...]
    unknown_joints: tuple[str, ...]


def guess(
    columns: dict[str, np.ndarray],
    model: ModelNames | None,
    lerobot: bool = False,
    lists: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
) -> Guess:
    """What the columns of one trial (by the file's names, as written) seem to be.

    Args:
        model: Its joints, where known.
        lerobot: Whether they are of a LeRobot data set.
        lists: Our stem -> the file's name of a list or array, whose places are columns by our name.
        units: The file's name -> what a row of units says of it.
    """
    joints = model.joints if model else ()
    names: dict[str, str] = {}
    ignored: list[str] = []
    unknown_joints: list[str] = []
    for name in columns:
        ours, left_out = _our_name(name, model)
        if ours is not None and ours not in names.values():
            names[name] = ours
        elif left_out:
            unknown_joints.append(left_out)
        else:
            ignored.append(name)
    if not any(role(ours, joints) and ours in TIME for ours in names.values()):
        clock = next((n for n in columns if is_clock(n) and _increases(columns[n])), None)
        if clock is not None:
            names[clock] = "time"
            ignored = [name for name in ignored if name != clock]
    by_ours = {ours: columns[name] for name, ours in names.items()}
    with_units = {name: f"{name} [{unit}]" for name, unit in (units or {}).items()}
    headings = {ours: with_units.get(name, name) for name, ours in names.items()}
    for ours in by_ours:
        if (
            (column_role := role(ours, joints))
            and (array := (lists or {}).get(column_role.stem))
            and headings[ours] == ours
        ):
            headings[ours] = array
    return Guess(
        columns={ours: name for name, ours in names.items() if ours != name},
        units=guess_units(by_ours, joints, lerobot, model, headings),
        ignored=tuple(ignored),
        unknown_joints=tuple(dict.fromkeys(unknown_joints)),
    )


def _our_name(name: str, model: ModelNames | None) -> tuple[str | None, str]:
    """Our name of a column, None for none, and what `ignore` calls one of no joint of the model."""
    joints = model.joints if model else ()
    actuators = {a.name for a in (model.actuators or ())} if model else set()
    parsed = heading(name, joints)
    # `time_s` is ours as it is
    is_ours = role(name) is not None and role(name) == role(parsed.name)
    name_without_unit = name if is_ours else parsed.name
    column_role = role(name_without_unit, joints)
    if column_role is None:
        return _ours(name_without_unit, joints) or _ours(name, joints) or _by_unit(
            parsed, joints
        ), ""
    is_actuator = column_role.stem == "ctrl" and column_role.joint in actuators
    if not isinstance(column_role.joint, str):
        ignore_name = ""
    else:
        # ctrl_ACTUATOR is kept; a joint is left out by its name as the reader tells it
        ignore_name = (
            name
            if column_role.joint in actuators or name_without_unit != name
            else column_role.joint
        )
    if ignore_name and joints and not (column_role.joint in joints or is_actuator):
        return _ours(name_without_unit, joints) or _ours(name, joints) or _by_unit(
            parsed, joints
        ), ignore_name
    if name_without_unit != name and column_role.stem == "time":
        return "time", ignore_name
    return name_without_unit, ignore_name


def array_name(name: str) -> str | None:
    """Our name of an array `[T, n]` such as `joint_positions`, whose columns are joints in order;
    None where it is none of ours.
    """
    name = heading(name).name
    ours = name if role(name) else _ours(name, ())
    found_role = role(ours) if ours else None
    if found_role and found_role.joint is None and found_role.stem not in ("time", "trial"):
        return ours
    return None


def is_clock(name: str) -> bool:
    """Whether a column is called as a time."""
    return bool(set(_tokens(name)) & set(SPELLINGS["words"]["clocks"]))


def _tokens(name: str) -> list[str]:
    return [token.lower() for token in re.split(r"[^A-Za-z0-9]+", name) if token]


def _ours(name: str, joints: Sequence[str]) -> str | None:
    """Our name of a column such as `/joint_states/elbow/position`, `shoulder_vel` or
    `joint_2_pos`.
    """
    tokens = [part for token in _tokens(name) for part in _word_and_number(token)]
    words = [token for token in tokens if token in WORDS]
    if not words or (set(tokens) & {"error", "err", "std", "min", "max", "raw"}):
        return None
    # "elbow_pos_desired" is a target, whatever quantity is desired
    stem = "target" if set(words) & TARGETS else WORDS[words[-1]]
    if stem == "target" and {"tau", "torque", "effort"} & set(words):
        return None
    if (
        stem == "target" and "data" in tokens
    ):  # an array of commands names no joints: it is in the order of the actuators
        stem = "ctrl"
    joints_named = [joint for joint in joints if _contains(tokens, _tokens(joint))]
    if joints_named:
        return f"{stem}_{max(joints_named, key=len)}"
    number = next(
        (
            re.sub(r"\D", "", token)
            for token in reversed(tokens)
            if re.fullmatch(r"(j|joint|motor|axis)?\d+", token)
        ),
        None,
    )
    if number:
        return f"{stem}{number}"
    other_tokens = [
        token
        for token in tokens
        if token not in WORDS and token not in SPELLINGS["words"]["measured"]
    ]
    if not joints:
        if other_tokens:
            return f"{stem}_{'_'.join(other_tokens)}"
        return stem
    nearest_joint = nearest("_".join(other_tokens), joints) if other_tokens else None
    if nearest_joint:
        return f"{stem}_{nearest_joint}"
    if len(joints) == 1 and not other_tokens:
        return stem
    return None


def _by_unit(parsed: Heading, joints: Sequence[str]) -> str | None:
    """Our name of a column that is called as a joint and nothing else: what is measured, its unit
    tells (`elbow (Nm)`).
    """
    stem = STEM_OF_UNIT.get(parsed.unit or "")
    joints_named = [
        joint
        for joint in joints
        if _tokens(joint) == [t for t in _tokens(parsed.name) if t != "joint"]
    ]
    if stem and len(joints_named) == 1:
        return f"{stem}_{joints_named[0]}"
    return None


def _word_and_number(token: str) -> tuple[str, ...]:
    """`position0`, as arrays are exported, is the word and its number; other tokens are whole."""
    match = re.fullmatch(r"([a-z]{3,})(\d+)", token)
    if match and match[1] in WORDS:
        return match.groups()
    return (token,)


def _contains(tokens: list[str], part: list[str]) -> bool:
    return any(tokens[i : i + len(part)] == part for i in range(len(tokens) - len(part) + 1))


def _increases(values: np.ndarray) -> bool:
    return bool(np.all(np.diff(values) > 0))


@dataclass(frozen=True)
class Draft:
    """What a `meta.toml` says beside its guesses.

    - `model`, `data`: Relative paths, None where there is none.
    - `names`: Of the model, where known.
    - `topics`: Lines about a bag's topics.
    - `ros`: Those that are chosen.
    - `kinds`: Input kinds that the columns allow.
    - `commands`: Trial -> the file that seems to hold its commands.
    """

    model: str | None = None
    data: str | None = None
    names: ModelNames | None = None
    topics: Sequence[str] = ()
    ros: Mapping[str, str | Sequence[str]] = field(default_factory=dict)
    kinds: Sequence[str] = ()
    commands: Mapping[str, str] = field(default_factory=dict)


def meta_text(found: Guess, draft: Draft) -> str:
    """A `meta.toml` with these guesses (`meta.toml.j2`)."""
    import jinja2

    units = [_unit_line(key, unit, why) for key, (unit, why) in found.units.items()]
    only_slides = draft.names is not None and set(draft.names.joints) <= set(draft.names.slides)
    has_scale = any(isinstance(unit, Scale) for unit, _ in found.units.values())
    if "angle" not in found.units and not only_slides and not has_scale:
        units.append('# angle = "rad"   # guess: the numbers look like radians')
    template = jinja2.Template(
        Path(__file__).with_name("meta.toml.j2").read_text(encoding="utf-8"),
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=jinja2.StrictUndefined,
    )
    return template.render(found=found, draft=draft, units=units, line=_line)


def _line(key: str, value: Any) -> str:
    """A line of TOML."""
    return dumps({key: value}).strip()


def _unit_line(key: str, unit: str | Scale | Question, why: str) -> str:
    """A line of `[units]`, a remark where a person must decide."""
    if isinstance(unit, Question):
        return f"# {_line(key, unit.unit)}   # guess, not taken: {why}"
    if not isinstance(unit, Scale):
        return f"{_line(key, unit)}   # guess: {why}"
    if unit.is_complete:
        return f"{unit.line}   # guess: {why}"
    return f"# {unit.line}   # guess: {why}; fill LOW and HIGH (rad, m)"
