"""A `meta.toml` guessed from the data: which column is what, in which units (`unit_guess`). Every
guess is marked as one.

Nothing here decides anything for good: a person reads the text, mends it, and takes the marks away.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from adaptsim_jax.core.config import dumps, nearest
from adaptsim_jax.logs.columns import STEMS, TIME, role
from adaptsim_jax.logs.headings import Heading, heading
from adaptsim_jax.logs.log import ModelNames
from adaptsim_jax.logs.log_units import quantity_of, units_of
from adaptsim_jax.logs.scales import Scale
from adaptsim_jax.logs.unit_guess import Question, Units, guess_units

WORDS = {word: stem for stem, words in STEMS.items() for word in words} | {
    "angle": "q",
    "angles": "q",
    "positions": "q",
    "qpos": "q",
    "theta": "q",
    "state": "q",
    "speed": "v",
    "velocities": "v",
    "qvel": "v",
    "omega": "v",
    "rate": "v",
    "efforts": "tau",
    "torques": "tau",
    "moment": "tau",
    "force": "tau",
    "command": "target",
    "cmd": "target",
    "desired": "target",
    "des": "target",
    "goal": "target",
    "reference": "target",
    "commands": "target",
    "targets": "target",
    "actions": "target",
    "ref": "target",
    "setpoint": "target",
    "action": "target",
    "control": "ctrl",
    "volts": "u",
    "amps": "i",
}
STEM_OF_UNIT = {
    unit: stem
    for stem in ("q", "v", "tau", "u", "i")
    for slides in (False, True)
    for unit in units_of(quantity_of(stem, slides), slides)
}
TARGETS = {word for word, stem in WORDS.items() if stem == "target"}
CLOCKS = (
    "time",
    "times",
    "timestamp",
    "timestamps",
    "stamp",
    "stamps",
    "t",
    "ts",
    "seconds",
    "clock",
)


@dataclass(frozen=True)
class Guess:
    """`columns`: our name -> the file's, those that need it; `units`: see `unit_guess.guess_units`;
    `ignored`: columns.
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
) -> Guess:
    """What the columns of one trial (by the file's names, as written) seem to be. `model`: its
    joints, where known; lerobot: whether they are of a LeRobot data set; lists: our stem -> the
    file's name of a list or array, whose places are columns by our name.
    """
    joints = model.joints if model else ()
    actuators = {a.name for a in (model.actuators or ())} if model else set()
    names: dict[str, str] = {}
    ignored: list[str] = []
    unknown: list[str] = []
    for name in columns:
        read = heading(name, joints)
        # `time_s` is ours as it is
        if role(name) is not None and role(name) == role(read.name):
            bare = name
        else:
            bare = read.name
        found_role = role(bare, joints)
        named = found_role and (
            found_role.joint in joints
            or (found_role.stem == "ctrl" and found_role.joint in actuators)
        )
        known = found_role and (not isinstance(found_role.joint, str) or not joints or named)
        if known:
            ours = bare
        else:
            ours = _ours(bare, joints) or _ours(name, joints) or _by_unit(read, joints)
        if known and bare != name and found_role and found_role.stem == "time":
            ours = "time"
        if ours is not None and ours not in names.values():
            names[name] = ours
        elif found_role and isinstance(found_role.joint, str):
            # ctrl_ACTUATOR is kept; a joint is left out by its name as the reader tells it
            unknown.append(
                name if found_role.joint in actuators or bare != name else found_role.joint
            )
        else:
            ignored.append(name)
    if not any(role(ours, joints) and ours in TIME for ours in names.values()):
        clock = next((n for n in columns if is_clock(n) and _increases(columns[n])), None)
        if clock is not None:
            names[clock] = "time"
            ignored = [name for name in ignored if name != clock]
    by_ours = {ours: columns[name] for name, ours in names.items()}
    written = {ours: name for name, ours in names.items()}
    for ours in by_ours:
        if (
            (found := role(ours, joints))
            and (array := (lists or {}).get(found.stem))
            and written[ours] == ours
        ):
            written[ours] = array
    return Guess(
        columns={ours: name for name, ours in names.items() if ours != name},
        units=guess_units(by_ours, joints, lerobot, model, written),
        ignored=tuple(ignored),
        unknown_joints=tuple(dict.fromkeys(unknown)),
    )


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
    return bool(set(_tokens(name)) & set(CLOCKS))


def _tokens(name: str) -> list[str]:
    return [token.lower() for token in re.split(r"[^A-Za-z0-9]+", name) if token]


def _ours(name: str, joints: Sequence[str]) -> str | None:
    """Our name of a column such as `/joint_states/elbow/position`, `shoulder_vel` or
    `joint_2_pos`.
    """
    tokens = [part for token in _tokens(name) for part in _word_and_number(token)]
    found = [token for token in tokens if token in WORDS]
    if not found or (set(tokens) & {"error", "err", "std", "min", "max", "raw"}):
        return None
    # "elbow_pos_desired" is a target, whatever quantity is desired
    stem = "target" if set(found) & TARGETS else WORDS[found[-1]]
    if stem == "target" and {"tau", "torque", "effort"} & set(found):
        return None
    if (
        stem == "target" and "data" in tokens
    ):  # an array of commands names no joints: it is in the order of the actuators
        stem = "ctrl"
    inside = [joint for joint in joints if _contains(tokens, _tokens(joint))]
    if inside:
        return f"{stem}_{max(inside, key=len)}"
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
    rest = [
        token
        for token in tokens
        if token not in WORDS
        and token not in ("joint", "state", "states", "joints", "measured", "actual")
    ]
    if not joints:
        if rest:
            return f"{stem}_{'_'.join(rest)}"
        return stem
    near = nearest("_".join(rest), joints) if rest else None
    if near:
        return f"{stem}_{near}"
    if len(joints) == 1 and not rest:
        return stem
    return None


def _by_unit(read: Heading, joints: Sequence[str]) -> str | None:
    """Our name of a column that is called as a joint and nothing else: what is measured, its unit
    tells (`elbow (Nm)`).
    """
    stem = STEM_OF_UNIT.get(read.unit or "")
    inside = [
        joint
        for joint in joints
        if _tokens(joint) == [t for t in _tokens(read.name) if t != "joint"]
    ]
    if stem and len(inside) == 1:
        return f"{stem}_{inside[0]}"
    return None


def _word_and_number(token: str) -> tuple[str, ...]:
    """`position0`, as arrays are exported, is the word and its number; other tokens are whole."""
    found = re.fullmatch(r"([a-z]{3,})(\d+)", token)
    if found and found[1] in WORDS:
        return found.groups()
    return (token,)


def _contains(tokens: list[str], part: list[str]) -> bool:
    return any(tokens[i : i + len(part)] == part for i in range(len(tokens) - len(part) + 1))


def _increases(values: np.ndarray) -> bool:
    return bool(np.all(np.diff(values) > 0))


# ---------------------------------------------------------------- the text


def meta_text(
    found: Guess,
    *,
    model: str | None,
    data: str | None,
    model_names: ModelNames | None,
    topics: Sequence[str] = (),
    ros: dict[str, str] | None = None,
    kinds: Sequence[str] = (),
    commands: Mapping[str, str] | None = None,
) -> str:
    """A `meta.toml` with these guesses. `topics`: lines about a bag's topics; `kinds`: input kinds
    that the columns allow; commands: trial -> the file that seems to hold its commands.
    """

    def line(key, value):
        return dumps({key: value}).strip()

    lines = [
        "# Written by 'adaptsim init' from the data. What is marked 'guess' was not declared by "
        "anyone: check it.",
        line("task", "mechanism"),
        line("model", model)
        if model
        else '# model = "robot.xml"   # MJCF or URDF, relative to this folder; or give --model',
    ]
    if model and model_names:
        lines.append(f"# joints of the model, in its order: {', '.join(model_names.joints)}")
    if data:
        lines.append(line("data", data))
    if len(kinds) > 1:
        lines.append(
            f"{line('input', kinds[0])}   # guess: the data also have columns of "
            f"{', '.join(kinds[1:])}"
        )
    if found.unknown_joints:
        lines.append(
            line("ignore", list(found.unknown_joints)) + "   # guess: joints that the model lacks"
        )
    if found.columns:
        lines += ["", "[columns]   # guess: our name = the file's name"]
        lines += [line(ours, theirs) for ours, theirs in found.columns.items()]
    if found.ignored:
        lines += ["", f"# columns that are not used: {', '.join(found.ignored)}"]
    lines += ["", "[units]   # s, rad, rad/s, N m, m, N, V, A where nothing else is said"]
    for key, (unit, why) in found.units.items():
        if isinstance(unit, Scale):
            lines.append(
                f"{'' if unit.known else '# '}{unit.line}   # guess: "
                f"{why}{'' if unit.known else '; fill LOW and HIGH (rad, m)'}"
            )
        elif isinstance(unit, Question):
            lines.append(f"# {line(key, unit.unit)}   # guess, not taken: {why}")
        else:
            lines.append(f"{line(key, unit)}   # guess: {why}")
    only_slides = model_names is not None and set(model_names.joints) <= set(model_names.slides)
    if (
        "angle" not in found.units
        and not only_slides
        and not any(isinstance(unit, Scale) for unit, _ in found.units.values())
    ):
        lines.append('# angle = "rad"   # guess: the numbers look like radians')
    lines += [
        "",
        "[angles]",
        'convention = "relative"   # guess: each angle counts from the link before it; "absolute": '
        "from the world",
        "# zero = {elbow = 1.5708}   # what the log shows (rad or m) where the model's joint is at "
        "0; guess: 0 for all",
        '# reversed = ["elbow"]   # joints that the log counts the other way round; guess: none',
    ]
    if topics:
        lines += [
            "",
            "[ros]",
            *(line(key, value) + "   # guess" for key, value in (ros or {}).items()),
            *(f"# {t}" for t in topics),
        ]
    given = ", ".join(f'"{trial}" = "{file}"' for trial, file in (commands or {}).items())
    if given:
        lines += [
            "",
            "[trials]",
            f"commands = {{{given}}}   # guess: files of commands, by their names",
        ]
    else:
        lines += []
    lines += [
        "",
        "# [noise]   # standard deviations in SI units, where known",
        "# q = 1e-4",
        "# [trials]",
        '# exclude = ["trial_03"]   # trials that went wrong',
        "# payload = {trial_04 = 0.2}   # kg at the tip",
    ]
    return "\n".join(lines) + "\n"
