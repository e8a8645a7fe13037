"""Columns of a raw trial given to the joints of a model, in SI units."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from adaptsim_jax.core.config import nearest
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.angles import Turns, follow_turns, turns_of
from adaptsim_jax.logs.columns import BASE, Role, roles_of
from adaptsim_jax.logs.criteria import TABLE
from adaptsim_jax.logs.headings import HeadingUnit, check_headings, heading_unit
from adaptsim_jax.logs.log import ModelNames
from adaptsim_jax.logs.log_meta import LogMeta
from adaptsim_jax.logs.log_units import ANGLE_UNITS, Affine, column_unit, command_unit, declared
from adaptsim_jax.logs.table_checks import check_size, check_time_unit, from_zero
from adaptsim_jax.logs.tables import RawTrial


@dataclass(frozen=True)
class JointColumns:
    """One trial's columns in SI units by stem and joint: `by_joint[stem] [T]` of each joint's
    index; `ctrl` by actuator.

    - `is_unwrapped`: Whether jumps of whole turns were taken out of angles.
    - `written`: (stem, joint) -> `[T]` as the file has it, of angles and targets.
    - `named`: (stem, joint) -> its column.
    - `scale`: (stem, joint) -> SI of one as written.
    - `base [T, 7]`: Place and orientation of a free base.
    - `channels`: By sensor of the model `[T]`.
    - `declared`: Joints for whose angles `[units]` has a unit.
    - `notes`: What is to be told of headings.
    """

    raw: RawTrial
    time: np.ndarray
    by_joint: dict[str, dict[int, np.ndarray]]
    ctrl: dict[int | str, np.ndarray]
    is_unwrapped: bool
    written: dict[tuple[str, int], np.ndarray] = field(default_factory=dict)
    named: dict[tuple[str, int], str] = field(default_factory=dict)
    scale: dict[tuple[str, int], float] = field(default_factory=dict)
    base: np.ndarray | None = None
    channels: dict[str, np.ndarray] = field(default_factory=dict)
    declared: frozenset[int] = frozenset()
    notes: tuple[str, ...] = ()

    def joint_array(self, stem: str, n: int) -> np.ndarray:
        """Collect the columns of a stem to an array `[T, n]`, NaN for joints without."""
        out = np.full((len(self.time), n), np.nan)
        for j, values in self.by_joint.get(stem, {}).items():
            out[:, j] = values
        return out

    def has_scale(self, j: int) -> bool:
        """Whether a joint's angles are declared in a scale that is no unit of angle."""
        own = (self.scale.get((stem, j), 1.0) for stem in ("q", "target"))
        return any(scale not in ANGLE_UNITS.values() for scale in own)


@dataclass
class _Converter:
    """Converts the columns of one trial to SI units, one by one.

    - `ctrl`, `by_joint`, `written`, `named`, `scale`, `declared`: As of `JointColumns`.
    - `headings`: What headings say of units, and the unit that is taken.
    - `multi_turn`: Joints whose encoder counts its turns: readings go beyond a turn.
    """

    trial: RawTrial
    names: ModelNames
    meta: LogMeta
    zero_based: bool
    by_joint: dict[str, dict[int, np.ndarray]] = field(default_factory=dict)
    ctrl: dict[int | str, np.ndarray] = field(default_factory=dict)
    written: dict[tuple[str, int], np.ndarray] = field(default_factory=dict)
    named: dict[tuple[str, int], str] = field(default_factory=dict)
    scale: dict[tuple[str, int], float] = field(default_factory=dict)
    declared: set[int] = field(default_factory=set)
    headings: list[tuple[HeadingUnit, Affine, tuple[str, ...], str]] = field(default_factory=list)
    multi_turn: set[int] = field(default_factory=set)

    def time(self, name: str, column_role: Role) -> np.ndarray:
        """Times `[T]` s."""
        where = f"{self.trial.path}: column {name}"
        scale = column_unit(where, self.meta.units, "time", (name,), slides=False).scale
        self._note_heading(name, column_role, (name,), Affine(scale))
        seconds = self.trial.columns[name] * scale
        check_time_unit(self.trial.path, seconds, scale)
        return seconds

    def command(self, name: str, column_role: Role) -> None:
        """A column of commands to an actuator."""
        key = _actuator_key(column_role, self.zero_based)
        words = column_role.words(name, _actuator_name(key, self.names))
        unit = command_unit(f"{self.trial.path}: column {name}", self.meta.units, words)
        self._note_heading(name, column_role, words, unit)
        self.ctrl[key] = unit.of(self.trial.columns[name])

    def joint(self, name: str, column_role: Role) -> None:
        """A column of a joint."""
        trial, names, units = self.trial, self.names, self.meta.units
        stem, j = column_role.stem, _joint_index(trial, name, column_role, names, self.zero_based)
        joint = names.joints[j]
        if (stem, j) in self.named:
            raise BadInput(
                f"{trial.path}: columns {self.named[stem, j]!r} and {name!r} are both {stem} of "
                f"joint {joint!r}; keep one, or write ignore = [{name!r}] in meta.toml"
            )
        self.named[stem, j] = name
        slides, words = joint in names.slides, column_role.words(name, joint)
        where, limits = f"{trial.path}: column {name}", names.limits_of(j)
        unit = column_unit(where, units, stem, words, slides=slides, limits=limits)
        self._note_heading(name, column_role, words, unit, slides)
        if stem == "q" and declared(units, "q", words, slides=slides) is not None:
            self.declared.add(j)
        raw = trial.columns[name]
        self.scale[stem, j] = unit.scale
        if stem in ("q", "target"):
            self.written[stem, j] = raw
        if stem == "q" and unit.count and np.nanmax(raw) - np.nanmin(raw) > unit.count:
            self.multi_turn.add(j)
        values = unit.of(raw)
        check_size(trial.path, name, values, trial.lines, trial.row_word)
        self.by_joint.setdefault(stem, {})[j] = values

    def _note_heading(
        self,
        name: str,
        column_role: Role,
        words: tuple[str, ...],
        unit: Affine,
        slides: bool = False,
    ) -> None:
        columns = self.meta.columns
        written = columns.get(name) or columns.get(column_role.stem, name)
        if name in self.trial.units:
            written = f"{written} [{self.trial.units[name]}]"
        if one := heading_unit(name, written, column_role, slides, self.names.joints):
            self.headings.append((one, unit, words, column_role.stem))


def columns_of(trial: RawTrial, names: ModelNames, meta: LogMeta) -> JointColumns:
    """The columns of a trial by joint. Raises `BadInput`: no such joint, two columns for one, a
    wrong unit, an absurd value.
    """
    roles = roles_of(trial.columns, names.joints)
    converter = _Converter(trial, names, meta, _zero_based(roles.values()))
    time = next(name for name, r in roles.items() if r.stem == "time")
    seconds = converter.time(time, roles[time])
    for name, column_role in roles.items():
        if column_role.stem == "ctrl":
            converter.command(name, column_role)
        elif column_role.stem not in ("time", "trial", "base", "channel"):
            converter.joint(name, column_role)
    notes = check_headings(trial.path, converter.headings, meta.units)
    angles, targets_as_logged = (converter.by_joint.get(stem, {}) for stem in ("q", "target"))
    wrapping = {j: q for j, q in angles.items() if j not in converter.multi_turn}
    unwrapped, gap_notes = _without_turns(trial, names, seconds, wrapping)
    unwrapped = angles | unwrapped
    if meta.targets == "relative":
        targets_as_logged = {j: angles[j] + u for j, u in targets_as_logged.items() if j in angles}
    targets = {
        j: follow_turns(unwrapped[j], u) if j in unwrapped and names.is_angle_target(j) else u
        for j, u in targets_as_logged.items()
    }
    channels = {
        str(r.joint): trial.columns[name] for name, r in roles.items() if r.stem == "channel"
    }
    by_joint = converter.by_joint | {"q": unwrapped}
    if targets:
        by_joint["target"] = targets
    is_unwrapped = _has_changed(unwrapped, angles) or _has_changed(targets, targets_as_logged)
    return JointColumns(
        trial,
        from_zero(seconds),
        by_joint,
        converter.ctrl,
        is_unwrapped,
        converter.written,
        converter.named,
        converter.scale,
        _base(trial, roles),
        channels,
        frozenset(converter.declared),
        (*notes, *gap_notes),
    )


def _has_changed(after: dict[int, np.ndarray], before: dict[int, np.ndarray]) -> bool:
    return any(not np.array_equal(after[j], x, equal_nan=True) for j, x in before.items())


def _without_turns(
    trial: RawTrial, names: ModelNames, seconds: np.ndarray, angles: dict[int, np.ndarray]
) -> tuple[dict[int, np.ndarray], list[str]]:
    """Angles without jumps of whole turns, and notes on gaps in which more may be hidden."""
    unwrapped, notes = dict(angles), []
    for j, q in angles.items():
        if names.joints[j] not in names.slides:
            turns = turns_of(seconds, q)
            unwrapped[j] = turns.q
            notes += _gap_notes(trial.name, names.joints[j], seconds, turns)
    return unwrapped, notes


def _gap_notes(trial: str, joint: str, seconds: np.ndarray, turns: Turns) -> tuple[str, ...]:
    """A note on gaps in which an angle that wraps may have turned further than can be told."""
    if not turns.unsure:
        return ()
    at = seconds[turns.unsure[0]] - seconds[0]
    return (
        f"{trial}: the angle of {joint} wraps, and may have turned further in {len(turns.unsure)} "
        f"gap(s), first at {at:.3g} s",
    )


def also_there(trial: RawTrial, stem: str, joint: str) -> str:
    """What to say of a trial's other columns where one is missing: it may be among them by another
    name.
    """
    ignored = [name for name in trial.ignored if name.strip()]
    if not ignored:
        return ""
    listed = f"{', '.join(ignored[:6])}{', ...' if len(ignored) > 6 else ''}"
    mend = f'write {stem}_{joint} = "..." under [columns], {stem} = "..." for lists of all'
    return f" (also there: {listed}; if it is one of these, {mend})"


def _actuator_key(column_role: Role, zero_based: bool) -> int | str:
    """The index or the name of the actuator that a column of commands speaks of."""
    if isinstance(column_role.joint, str):
        return column_role.joint
    if column_role.joint is not None:
        return column_role.joint - (not zero_based)
    return 0


def _actuator_name(place: int | str, names: ModelNames) -> str:
    """The name of the actuator at this place, '' where the model's are not known."""
    actuators = names.actuators or ()
    if isinstance(place, str):
        return place
    if 0 <= place < len(actuators):
        return actuators[place].name
    return ""


def _base(trial: RawTrial, roles: dict[str, Role]) -> np.ndarray | None:
    """`[T, 7]` m and a unit quaternion whose sign does not jump. Raises `BadInput` where a column
    of them is missing.
    """
    column_of = {
        str(column_role.joint): name
        for name, column_role in roles.items()
        if column_role.stem == "base"
    }
    if not column_of:
        return None
    if missing := [name for name in BASE if name not in column_of]:
        raise BadInput(
            f"{trial.path}: has base_{next(iter(column_of))}, but no base_{missing[0]}; add it, or "
            "ignore all of them"
        )
    pose = np.stack([trial.columns[column_of[name]] for name in BASE], 1)
    norm = np.linalg.norm(pose[:, 3:], axis=1)
    if not_unit := np.flatnonzero(np.abs(norm - 1.0) > TABLE.max_norm_error).tolist():
        raise BadInput(
            f"{trial.path}: {trial.row_word} {trial.lines[not_unit[0]]}: base_qw .. base_qz have "
            f"length {norm[not_unit[0]]:.3g}; write unit quaternions"
        )
    pose[:, 3:] /= norm[:, None]
    products = np.sum(pose[1:, 3:] * pose[:-1, 3:], 1)
    flips = np.cumprod(np.sign(products) + (products == 0))
    pose[1:, 3:] *= flips[:, None]
    return pose


def _zero_based(roles: Iterable[Role]) -> bool:
    return any(r.joint == 0 for r in roles)


def _joint_index(
    trial: RawTrial, name: str, column_role: Role, names: ModelNames, zero_based: bool
) -> int:
    """The index of the model's joint that a column belongs to."""
    n, joint = len(names.joints), column_role.joint
    if isinstance(joint, str):
        if joint in names.joints:
            return names.joints.index(joint)
        mend = f'rename it by [columns] in meta.toml, or write ignore = ["{joint}"]'
        suggestion = nearest(joint, names.joints)
        if suggestion:
            hint = f"did you mean '{suggestion}'?"
        else:
            hint = f"it has {', '.join(names.joints)};"
        raise BadInput(
            f"{trial.path}: column {name!r}: the model has no joint '{joint}'; {hint} {mend}"
        )
    if joint is None:
        if n > 1:
            raise BadInput(
                f"{trial.path}: column {name!r} names no joint, but the model has {n}; name it "
                f"{name}1 or {name}_{names.joints[0]}"
            )
        return 0
    index = joint if zero_based else joint - 1
    if not 0 <= index < n:
        mend = (
            f"name joints of the model only ({', '.join(names.joints)}), or write ignore = "
            f'["{name}"] in meta.toml'
        )
        raise BadInput(f"{trial.path}: column {name!r}: the model has {n} joint(s); {mend}")
    return index
