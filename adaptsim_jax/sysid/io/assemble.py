"""Raw trials of named columns made into a `Log`: joints of the model, in its order, angles and units."""

from __future__ import annotations

import fnmatch
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from adaptsim_jax.core.config import nearest, suggest
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.sysid.io.columns import Role, role
from adaptsim_jax.sysid.io.inputs import Inputs, choose_inputs
from adaptsim_jax.sysid.io.log import Log, LogTrial, ModelNames
from adaptsim_jax.sysid.io.log_meta import LogMeta
from adaptsim_jax.sysid.io.log_units import column_scale
from adaptsim_jax.sysid.io.tables import RawTrial

EPOCH = 1e6
"""Times beyond this (s) are clock time: they are counted from the trial's first row, to lose no digit."""
LIMIT = 1e5
"""Magnitude in SI units beyond which a value is damage, not data."""
V = TypeVar("V")


@dataclass(frozen=True)
class Columns:
    """One trial's columns in SI units by stem and joint: `by_joint[stem] [T]` of each joint's index; `ctrl` by actuator."""

    raw: RawTrial
    time: np.ndarray
    by_joint: dict[str, dict[int, np.ndarray]]
    ctrl: dict[int | str, np.ndarray]

    def stacked(self, stem: str, n: int) -> np.ndarray:
        """`[T, n]` of a quantity, NaN for joints without."""
        out = np.full((len(self.time), n), np.nan)
        for j, values in self.by_joint.get(stem, {}).items():
            out[:, j] = values
        return out


def assemble(path: str, raw: list[RawTrial], model: ModelNames | None, meta: LogMeta) -> Log:
    """The `Log` of these raw trials. Raises `BadInput` where a joint, column or unit does not fit the model."""
    raw = [_without_ignored(trial, meta, model) for trial in _kept(path, raw, meta)]
    names = model or _names_in(raw[0])
    _check_meta_names(names, raw, meta)
    trials = [_columns(trial, names, meta) for trial in raw]
    inputs = choose_inputs(path, trials, names, meta)
    log_trials = tuple(_trial(columns, names, meta, inputs) for columns in trials)
    return Log(
        path=path,
        meta=meta,
        joint_names=names.joints,
        trials=log_trials,
        input_kind=inputs.kind,
        input_names=inputs.names,
        driven=inputs.driven,
        notes=inputs.notes + _notes(raw, log_trials),
    )


# ---------------------------------------------------------------- which trials, which columns


def _kept(path: str, raw: list[RawTrial], meta: LogMeta) -> list[RawTrial]:
    names = [trial.name for trial in raw]
    for key, patterns in (("exclude", meta.exclude), ("group", meta.group), ("payload", meta.payload)):
        for pattern in patterns:
            if not fnmatch.filter(names, pattern):
                raise BadInput(
                    f"{meta.path}: trials.{key} names {pattern!r}, no trial of {path}; {suggest(pattern, names)}"
                )
    kept = [trial for trial in raw if not any(fnmatch.fnmatchcase(trial.name, p) for p in meta.exclude)]
    if not kept:
        raise BadInput(f"{meta.path}: trials.exclude leaves no trial; keep one")
    return kept


def _without_ignored(trial: RawTrial, meta: LogMeta, model: ModelNames | None) -> RawTrial:
    """The trial without columns that are not ours, and those that `ignore` names: themselves, or by their joint."""
    joints = model.joints if model else ()
    out = {}
    for name, values in trial.columns.items():
        found = role(name, joints)
        joint = found.joint if found and isinstance(found.joint, str) else None
        if found and name not in meta.ignore and joint not in meta.ignore:
            out[name] = values
    gone = tuple(name for name in trial.columns if name not in out)
    return RawTrial(
        trial.name, trial.path, out, trial.lines, trial.row_word, (*trial.ignored, *gone), trial.notes, trial.group
    )


def _names_in(trial: RawTrial) -> ModelNames:
    """The joints that a trial's own angle columns name, in their order."""
    roles = [role(name) for name in trial.columns]
    angles = [r.joint for r in roles if r and r.stem == "q"]
    if any(isinstance(joint, str) for joint in angles):
        joints = tuple(joint if isinstance(joint, str) else f"joint{joint}" for joint in angles)
    else:
        joints = tuple(f"joint{i}" for i in range(1, len(angles) + 1))
    if not joints:
        raise BadInput(f"{trial.path}: has no angle column; add q1, q2, ... or q_NAME (rad), or name them by [columns]")
    return ModelNames(joints)


def _check_meta_names(names: ModelNames, raw: list[RawTrial], meta: LogMeta) -> None:
    columns = [name for trial in raw for name in trial.columns]
    known = (*names.joints, *dict.fromkeys(columns), "q", "")
    for key, given in (("convention", meta.convention), ("zero", meta.zero), ("reversed", meta.reversed)):
        for name in given:
            if name not in known:
                joints = suggest(name, (*names.joints, *(c for c in dict.fromkeys(columns) if c.startswith("q"))))
                raise BadInput(f"{meta.path}: angles.{key} names {name!r}, no joint and no column; {joints}")
    quantities = ("time", "angle", "velocity", "torque", "length", "force", "voltage", "current")
    stems = ("q", "v", "tau", "target", "u", "i", "tau_commanded")
    words = {w for name in dict.fromkeys(columns) for w in _words(name, names)}
    for table, given in (("units", meta.units), ("noise", meta.noise)):
        for name in given:
            if name not in (*quantities, *stems) and name not in words:
                near = suggest(name, (*quantities, *stems, *sorted(words)))
                raise BadInput(f"{meta.path}: [{table}] {name!r} is no column, joint or quantity of the data; {near}")


def _words(name: str, names: ModelNames) -> tuple[str, ...]:
    found = role(name, names.joints)
    if found is None or found.stem in ("time", "trial"):
        return (name,)
    if isinstance(found.joint, str):
        return found.words(name, found.joint)
    index = (found.joint or 1) - 1
    joint = names.joints[index] if 0 <= index < len(names.joints) else ""
    return found.words(name, joint)


def _columns(trial: RawTrial, names: ModelNames, meta: LogMeta) -> Columns:
    roles = {name: found for name in trial.columns if (found := role(name, names.joints)) is not None}
    zero_based = _zero_based(roles.values())
    time = next(name for name, r in roles.items() if r.stem == "time")
    where = f"{trial.path}: column {time}"
    seconds = trial.columns[time] * column_scale(where, meta.units, "time", (time,), slides=False)
    by_joint: dict[str, dict[int, np.ndarray]] = {}
    ctrl: dict[int | str, np.ndarray] = {}
    taken: dict[tuple[str, int], str] = {}
    for name, found in roles.items():
        if found.stem in ("time", "trial"):
            continue
        if found.stem == "ctrl":
            ctrl[found.joint if isinstance(found.joint, str) else (found.joint or 1) - (not zero_based)] = (
                trial.columns[name]
            )
            continue
        j = _joint(trial, name, found, names, zero_based)
        if (found.stem, j) in taken:
            raise BadInput(
                f"{trial.path}: columns {taken[found.stem, j]!r} and {name!r} are both {found.stem} of joint "
                f"{names.joints[j]!r}; keep one, or write ignore = [{name!r}] in meta.toml"
            )
        taken[found.stem, j] = name
        slides = names.joints[j] in names.slides
        words = found.words(name, names.joints[j])
        scale = column_scale(f"{trial.path}: column {name}", meta.units, found.stem, words, slides=slides)
        by_joint.setdefault(found.stem, {})[j] = _sized(trial, name, trial.columns[name] * scale)
    return Columns(trial, seconds - seconds[0] if abs(seconds[0]) > EPOCH else seconds, by_joint, ctrl)


def _zero_based(roles: Iterable[Role]) -> bool:
    return any(r.joint == 0 for r in roles)


def _joint(trial: RawTrial, name: str, found: Role, names: ModelNames, zero_based: bool) -> int:
    """The index of the model's joint that a column belongs to."""
    n, joint = len(names.joints), found.joint
    if isinstance(joint, str):
        if joint in names.joints:
            return names.joints.index(joint)
        mend = f'rename it by [columns] in meta.toml, or write ignore = ["{joint}"]'
        near = nearest(joint, names.joints)
        hint = f"did you mean '{near}'?" if near else f"it has {', '.join(names.joints)};"
        raise BadInput(f"{trial.path}: column {name!r}: the model has no joint '{joint}'; {hint} {mend}")
    if joint is None:
        if n > 1:
            raise BadInput(
                f"{trial.path}: column {name!r} names no joint, but the model has {n}; name it {name}1 or {name}_{names.joints[0]}"
            )
        return 0
    index = joint if zero_based else joint - 1
    if not 0 <= index < n:
        mend = f'name joints of the model only ({", ".join(names.joints)}), or write ignore = ["{name}"] in meta.toml'
        raise BadInput(f"{trial.path}: column {name!r}: the model has {n} joint(s); {mend}")
    return index


def _sized(trial: RawTrial, name: str, values: np.ndarray) -> np.ndarray:
    bad = np.flatnonzero(np.abs(values) > LIMIT)
    if bad.size:
        where = f"{trial.row_word} {trial.lines[bad[0]]}"
        why = f"column {name} is {values[bad[0]]:.4g} in SI units, beyond {LIMIT:g}"
        raise BadInput(f"{trial.path}: {where}: {why}; mend that row, or declare [units] in meta.toml")
    return values


# ---------------------------------------------------------------- joints' angles


def _trial(columns: Columns, names: ModelNames, meta: LogMeta, inputs: Inputs) -> LogTrial:
    raw, n = columns.raw, len(names.joints)
    here = columns.by_joint.get("q", {})
    for j, joint in enumerate(names.joints):
        if j not in here:
            have = [names.joints[k] for k in here]
            mend = f"record it, or take a model without it (the data have {', '.join(have) or 'no angle'})"
            near = nearest(joint, [c for c in (*raw.columns, *raw.ignored) if c not in have])
            hint = f"did you mean '{near}'? Then name it by [columns] in meta.toml;" if near and not have else ""
            raise BadInput(
                f"{raw.path}: no angle of the model's joint '{joint}' (column q{j + 1} or q_{joint}); {hint}{mend}"
            )
    speeds = columns.by_joint.get("v", {})
    if speeds and len(speeds) < n:
        lacks = next(joint for j, joint in enumerate(names.joints) if j not in speeds)
        raise BadInput(
            f"{raw.path}: has velocities, but none of joint '{lacks}'; add column v_{lacks}, or leave all out"
        )
    q = model_angles(columns.stacked("q", n), names, meta)
    v = model_angles(columns.stacked("v", n), names, meta, rates=True) if speeds else None
    extra = {stem: columns.stacked(stem, n) for stem in columns.by_joint if stem not in ("q", "v", inputs.stem)}
    if "target" in extra:
        extra["target"] = model_angles(extra["target"], names, meta)
    return LogTrial(
        name=raw.name,
        path=raw.path,
        time=columns.time,
        q=q,
        v=v,
        u=inputs.of(columns, names, meta),
        group=_of(meta.group, raw.name, "") or raw.group,
        payload=_of(meta.payload, raw.name, 0.0),
        extra=extra,
    )


def model_angles(logged: np.ndarray, names: ModelNames, meta: LogMeta, *, rates: bool = False) -> np.ndarray:
    """The model's joint positions `[T, n]` (or their rates) from logged ones in SI units.

    A zero is taken off first, then an absolute angle less that of the joint before it, then a reversed joint turned.
    """
    zero = np.array([_declared(meta.zero, i, j, 0.0) for i, j in enumerate(names.joints)])
    shown = logged if rates else logged - zero
    out = shown.copy()
    for i, (joint, parent) in enumerate(zip(names.joints, names.parent_of, strict=True)):
        if _declared(meta.convention, i, joint, meta.convention.get("", "relative")) == "absolute" and parent >= 0:
            out[:, i] = shown[:, i] - shown[:, parent]
    flipped = [_declared(dict.fromkeys(meta.reversed, True), i, joint, False) for i, joint in enumerate(names.joints)]
    out[:, flipped] *= -1.0
    return out


def _declared(table: Mapping[str, V], index: int, joint: str, default: V) -> V:
    """What `[angles]` gives a joint, by its name or by that of its column."""
    words = (joint, f"q_{joint}", f"q{index + 1}", *(("q",) if index == 0 else ()))
    return next((table[word] for word in words if word in table), default)


def _of(table: Mapping[str, V], trial: str, default: V) -> V:
    """What `[trials]` gives a trial: its own name counts before patterns."""
    if trial in table:
        return table[trial]
    return next((value for pattern, value in table.items() if fnmatch.fnmatchcase(trial, pattern)), default)


def _notes(raw: Sequence[RawTrial], trials: Sequence[LogTrial]) -> tuple[str, ...]:
    notes = list(dict.fromkeys(note for trial in raw for note in trial.notes))
    ignored = sorted({column for trial in raw for column in trial.ignored})
    if ignored:
        notes.append(f"columns ignored: {', '.join(ignored)}")
    kept = sorted({stem for trial in trials for stem in trial.extra})
    if kept:
        notes.append(f"columns kept beside the input: {', '.join(kept)}")
    if any(trial.v is None for trial in trials):
        notes.append(
            "some trials have no velocities" if any(t.v is not None for t in trials) else "no velocities logged"
        )
    missing = {trial.name: int(np.isnan(trial.q).sum()) for trial in trials if np.isnan(trial.q).any()}
    if missing:
        notes.append(f"angles missing: {', '.join(f'{count} in {name}' for name, count in missing.items())}")
    return tuple(notes)
