"""What a column's name says: which quantity of which joint (`q3`, `q_elbow`, `tau`,
`target_elbow`).
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

SPELLINGS: dict[str, dict[str, list[str]]] = tomllib.loads(
    Path(__file__).with_name("spellings.toml").read_text(encoding="utf-8")
)
"""How loggers call columns, files and units."""


def key_of(table: str) -> dict[str, str]:
    """Each word of a table of `SPELLINGS` -> its key, such as our stem."""
    return {word: key for key, words in SPELLINGS[table].items() for word in words}


TIME = ("time", "t", "timestamp", "time_s", "stamp")
NANOS = "time_nanos"
"""The column of nanoseconds that are added to a time of whole seconds."""
COUNTERS = SPELLINGS["counters"]["names"]
"""Of rows, as they were taken."""
TRIAL = ("trial", "episode", "episode_index")
BASE = ("x", "y", "z", "qw", "qx", "qy", "qz")
"""Columns `base_x` .. `base_qz`: where a free base is (m), and its orientation as a unit
quaternion.
"""
CHANNEL = "channel:"
"""What opens our name of a column that `[channels]` gives to a sensor of the model."""
_STEM_OF = key_of("stems")
_PATTERN = re.compile(
    rf"({'|'.join(sorted(_STEM_OF, key=len, reverse=True))})(?:_?(\d+)|[_./ ](.+))?"
)

_PRESENT = re.compile(r"(present|actual)(_(rad|deg|m|s))*")
"""What servos' registers are called, with their unit: no joint."""


@dataclass(frozen=True)
class Role:
    """`stem`: time, nanos, trial, base, channel, q, v, tau, tau_commanded, target, ctrl, u, i;
    `joint`: its number as written, name, None.
    """

    stem: str
    joint: int | str | None = None

    def words(self, name: str, joint: str) -> tuple[str, ...]:
        """The names that `meta.toml` may give this column, closest first; `joint` is the model's
        name of it.
        """
        if self.stem == "tau_commanded":
            stem, after = ("tau", "_commanded")
        else:
            stem, after = (self.stem, "")
        if isinstance(self.joint, str) or self.joint is None:
            number = ""
        else:
            number = self.joint
        return (name, f"{stem}{number}{after}", f"{stem}_{joint}{after}", joint)


def role(name: str, joints: Iterable[str] = ()) -> Role | None:
    """The role that a column's name tells; None for a column that is none of ours.

    Args:
        joints: The model's, where known.
    """
    if name in TIME:
        return Role("time")
    if name == NANOS:
        return Role("nanos")
    if name in TRIAL:
        return Role("trial")
    if name.startswith(CHANNEL):
        return Role("channel", name.removeprefix(CHANNEL))
    if name.startswith("base_") and name.removeprefix("base_") in BASE:
        return Role("base", name.removeprefix("base_"))
    is_commanded = name.endswith("_commanded")
    match = _PATTERN.fullmatch(name.removesuffix("_commanded") if is_commanded else name)
    if not match:
        return None
    stem, number, joint = _STEM_OF[match[1]], match[2], match[3]
    joints = tuple(joints)
    if number and number not in joints:
        joint_of: int | str | None = int(number)
    else:
        joint_of = number or joint
    if (
        isinstance(joint_of, str)
        and joint_of not in joints
        and _PRESENT.fullmatch(joint_of.lower())
    ):
        joint_of = None
    is_letter = (
        stem == "ctrl" and joint_of is not None and len(str(joint_of)) == 1
    )  # an actuator may well be called m
    if (
        isinstance(joint_of, str)
        and joint_of not in joints
        and joint_of.lower() in SPELLINGS["words"]["not_joints"]
        and not is_letter
    ):
        return None
    if is_commanded:
        if stem == "tau":
            return Role("tau_commanded", joint_of)
        return None
    return Role(stem, joint_of)


def roles_of(names: Iterable[str], joints: Iterable[str] = ()) -> dict[str, Role]:
    """The roles of those columns that are ours, by name.

    Args:
        joints: The model's.
    """
    joints = tuple(joints)
    return {name: column_role for name in names if (column_role := role(name, joints)) is not None}


def is_ignored(name: str, ignore: Iterable[str], joints: Iterable[str] = ()) -> bool:
    """Whether `ignore` leaves this column out, by its own name or by that of its joint."""
    column_role = role(name, joints)
    return name in ignore or (
        column_role is not None
        and isinstance(column_role.joint, str)
        and column_role.joint in ignore
    )
