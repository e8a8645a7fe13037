"""Raw trials of named columns made into a `Log`: joints of the model, in its order, angles and
units.
"""

from __future__ import annotations

import fnmatch
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from adaptsim_jax.core.config import suggest
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.angles import model_angles
from adaptsim_jax.logs.beside import copies, unread
from adaptsim_jax.logs.columns import is_ignored, role, roles_of
from adaptsim_jax.logs.counters import counted
from adaptsim_jax.logs.criteria import TABLE
from adaptsim_jax.logs.inputs import Inputs, choose_inputs
from adaptsim_jax.logs.joint_columns import JointColumns, also_there, columns_of
from adaptsim_jax.logs.log import Log, LogTrial, ModelNames
from adaptsim_jax.logs.log_meta import LogMeta
from adaptsim_jax.logs.quality.consistency import jitter
from adaptsim_jax.logs.quality.holes import holes
from adaptsim_jax.logs.repeats import read_once
from adaptsim_jax.logs.scales import check_log_units, check_scales
from adaptsim_jax.logs.speeds import Written
from adaptsim_jax.logs.tables import RawTrial
from adaptsim_jax.logs.words import WORDS, unanswered, word_of


def assemble(path: str, raw: list[RawTrial], model: ModelNames | None, meta: LogMeta) -> Log:
    """The `Log` of these raw trials. Raises `BadInput` where a joint, column or unit does not fit
    the model.
    """
    raw = [counted(trial) for trial in _included(path, raw, meta)]
    raw = [_without_ignored(trial, meta, model) for trial in raw]
    raw = [_without_missing(trial, meta) for trial in raw]
    raw, word_notes = _decode_words(raw)
    raw = [read_once(trial) for trial in raw]
    names = model or _names_in(raw[0])
    _check_meta_names(names, raw, meta)
    trials = [columns_of(trial, names, meta) for trial in raw]
    scale_notes = check_scales(trials, names)
    moving, held = _moving(path, trials, names, meta)
    inputs = choose_inputs(trials, names, meta, [names.joints[j] for j in moving])
    log_trials = tuple(_trial(columns, names, meta, inputs, moving) for columns in trials)
    _check_clocks(raw, log_trials)
    log_trials, pause_notes = _cut_pauses(log_trials)
    log_trials, even_notes = _even_rows(log_trials)
    heading_notes = tuple(dict.fromkeys(note for columns in trials for note in columns.notes))
    declared_joints = {names.joints[j] for columns in trials for j in columns.declared}
    speed_columns = {
        names.joints[j]: Written(*(trials[0].named[s, j] for s in ("q", "v")), scale)
        for (stem, j), scale in trials[0].scale.items()
        if stem == "v" and j in moving
    }
    moving_names = names.only(moving)
    unit_notes = (
        heading_notes
        + scale_notes
        + check_log_units(log_trials, moving_names, meta.units, declared_joints, speed_columns)
    )
    unwrapped_trials = [columns.raw.name for columns in trials if columns.is_unwrapped]
    if unwrapped_trials:
        unwrap_notes = (
            "jumps of whole turns taken out of the angles (and targets) of "
            f"{', '.join(unwrapped_trials)}",
        )
    else:
        unwrap_notes = ()
    notes = (
        inputs.notes
        + word_notes
        + _unmatched_notes(raw[0], names, held)
        + _numbering_notes(raw[0], names, moving)
        + _notes(raw, log_trials)
    )
    copy_notes = copies([(t.name, t.q) for t in log_trials])
    return Log(
        path=path,
        meta=meta,
        joint_names=tuple(names.joints[j] for j in moving),
        trials=log_trials,
        input_kind=inputs.kind,
        input_names=inputs.names,
        driven=inputs.driven,
        input_columns=_input_columns(raw[0], names, inputs),
        notes=notes
        + unwrap_notes
        + pause_notes
        + even_notes
        + unit_notes
        + copy_notes
        + unread(meta.data or path),
        held=held,
    )


def _moving(
    path: str, trials: list[JointColumns], names: ModelNames, meta: LogMeta
) -> tuple[list[int], dict[str, float | None]]:
    """Numbers of the joints that have angles and move, and where the others are held (None: nothing
    of them is logged).

    Raises BadInput where no joint has angles, or one has in some trials only.
    """
    _check_named(meta, "[hold]", meta.hold, names.joints, "no joint of the model")
    n, logged = len(names.joints), trials[0].by_joint.get("q", {})
    if not n:
        if any(columns.base is None and not columns.channels for columns in trials):
            raise BadInput(
                f"{path}: the model has no joint but its base's; log base_x, base_y, base_z (m) "
                "and base_qw .. base_qz"
            )
        return [], {}
    _check_angles(trials, names, meta)
    angles = [model_angles(columns.joint_array("q", n), names, meta) for columns in trials]
    all_angles = np.concatenate(angles)
    has_angle: np.ndarray = np.any(np.isfinite(all_angles), axis=0)
    moving, held = [], {}
    for j, joint in enumerate(names.joints):
        angle = all_angles[:, j]
        median = float(np.nanmedian(angle)) if has_angle[j] else None
        is_still = has_angle[j] and float(np.nanmax(angle) - np.nanmin(angle)) == 0.0
        if joint in meta.hold:
            value = meta.hold[joint]
            held[joint] = median if value is None else value
        elif j not in logged:
            held[joint] = None
        elif is_still and meta.rig is None:  # of a pendulum a sensor is stuck then
            held[joint] = median
        else:
            moving.append(j)
    if not moving:
        raise BadInput(f"{path}: no joint moves in any trial; log one that does")
    return moving, held


def _check_angles(trials: list[JointColumns], names: ModelNames, meta: LogMeta) -> None:
    """BadInput where a trial lacks the angle of a joint that others, or its own columns, have."""
    angles_by_trial = [columns.by_joint.get("q", {}) for columns in trials]
    for columns, angles in zip(trials, angles_by_trial, strict=True):
        if not angles:
            _raise_no_angle(columns, names, 0, angles)
        moving = {
            j
            for rows in columns.by_joint.values()
            for j, x in rows.items()
            if len(np.unique(x[np.isfinite(x)])) > 1
        }
        for j in sorted(set().union(*angles_by_trial, moving) - set(angles)):
            if names.joints[j] not in meta.hold:
                _raise_no_angle(columns, names, j, angles)


def _raise_no_angle(
    columns: JointColumns, names: ModelNames, j: int, angles: Mapping[int, np.ndarray]
) -> None:
    raw, joint = columns.raw, names.joints[j]
    if not angles:
        raise BadInput(
            f"{raw.path}: has no angles; add columns q1 or q_{joint}, one for each "
            f"joint{also_there(raw, 'q', joint)}"
        )
    present = [names.joints[k] for k in angles]
    mend = (
        f"record it in every trial, or write [hold] and {joint} = 0.0 in meta.toml, in rad or m "
        f"(this trial has {', '.join(present)})"
    )
    raise BadInput(
        f"{raw.path}: no angle of the model's joint '{joint}' (column q{j + 1} or q_{joint}); "
        f"{mend}"
    )


def _unmatched_notes(
    trial: RawTrial, names: ModelNames, held: Mapping[str, float | None]
) -> tuple[str, ...]:
    """A joint that nothing was logged of beside angles that no joint of the model has: the same by
    another name?
    """
    unlogged = [name for name, value in held.items() if value is None]
    ignored_angles = [n for n, r in roles_of(trial.ignored, names.joints).items() if r.stem == "q"]
    if not unlogged or not ignored_angles:
        return ()
    return (
        f"nothing is logged of {', '.join(unlogged)}, held; {', '.join(ignored_angles)} is left "
        "out: if it is the same, name it by [columns]",
    )


def _numbering_notes(trial: RawTrial, names: ModelNames, moving: Sequence[int]) -> tuple[str, ...]:
    """Which joints columns that go by number are taken for, where the model has more."""
    roles = roles_of(trial.columns, names.joints).values()
    is_numbered = any(r.stem == "q" and isinstance(r.joint, int) for r in roles)
    if len(moving) == len(names.joints) or not is_numbered:
        return ()
    return (
        "columns go by number, in the model's order of joints: "
        f"{', '.join(names.joints[j] for j in moving)}",
    )


def _input_columns(trial: RawTrial, names: ModelNames, inputs: Inputs) -> tuple[str, ...]:
    """The column that each input was read from, empty where there is none."""
    if inputs.kind == "command":
        stems = ("ctrl", "target")
    else:
        stems = (inputs.stem,)
    all_roles = roles_of(trial.columns, names.joints)
    roles = {name: r for name, r in all_roles.items() if r.stem in stems}
    base = 0 if any(r.joint == 0 for r in all_roles.values()) else 1
    number_of = {joint: k + base for k, joint in enumerate(names.joints)}
    columns = []
    for index, name in enumerate(inputs.names):
        joint = inputs.actuators[index].joint if inputs.actuators else name
        keys_by_stem = {"ctrl": (name, joint, index + base)}
        joint_keys = (joint, number_of.get(joint))
        matches = sorted(
            (r.stem, c) for c, r in roles.items() if r.joint in keys_by_stem.get(r.stem, joint_keys)
        )
        columns.append(matches[0][1] if matches else "")
    return tuple(columns)


def _included(path: str, raw: list[RawTrial], meta: LogMeta) -> list[RawTrial]:
    names = [trial.name for trial in raw]
    matched = [pattern for pattern in meta.exclude if fnmatch.filter(names, pattern)]
    _check_named(meta, "trials.exclude", meta.exclude, matched, f"no trial of {path}", names)
    included = [
        trial for trial in raw if not any(fnmatch.fnmatchcase(trial.name, p) for p in meta.exclude)
    ]
    if not included:
        raise BadInput(f"{meta.path}: trials.exclude leaves no trial; keep one")
    too_short = [trial.name for trial in included if len(trial.lines) < TABLE.min_rows]
    long_enough = [trial for trial in included if trial.name not in too_short]
    if not long_enough:
        raise BadInput(
            f"{path}: {too_short[0]} has {len(included[0].lines)} rows; a trial needs at least "
            f"{TABLE.min_rows}"
        )
    if not too_short:
        return included
    note = f"fewer than {TABLE.min_rows} rows, left out: {', '.join(too_short)}"
    return [replace(long_enough[0], notes=(*long_enough[0].notes, note)), *long_enough[1:]]


def _without_ignored(trial: RawTrial, meta: LogMeta, model: ModelNames | None) -> RawTrial:
    """The trial without columns that are not ours, and those that `ignore` names: themselves, or by
    their joint.
    """
    joints = model.joints if model else ()
    columns = {
        n: v
        for n, v in trial.columns.items()
        if role(n, joints) and not is_ignored(n, meta.ignore, joints)
    }
    ignored = tuple(name for name in trial.columns if name not in columns)
    return replace(trial, columns=columns, ignored=(*trial.ignored, *ignored))


def _without_missing(trial: RawTrial, meta: LogMeta) -> RawTrial:
    """The trial where a few rows lack numbers, or a register did not answer: what acts, acts on
    from the row before; rows without a pose or a sensor are left out, and those before anything
    acts. Angles and speeds are NaN, but for a pendulum, whose rows are whole.
    """
    is_missing_in = {name: np.isnan(x) | unanswered(x) for name, x in trial.columns.items()}
    few_missing = {
        name: rows
        for name, rows in is_missing_in.items()
        if 0 < rows.mean() <= TABLE.max_missing_share
    }
    if not few_missing:
        return trial
    columns, is_complete = dict(trial.columns), np.ones(len(trial.lines), bool)
    for name, rows in few_missing.items():
        columns[name] = np.where(rows, np.nan, columns[name])
        column_role = role(name)
        if meta.rig is not None or (
            column_role and column_role.stem in ("time", "base", "channel")
        ):
            is_complete &= ~rows
        elif column_role is None or column_role.stem not in ("q", "v"):
            last = np.maximum.accumulate(np.where(rows, -1, np.arange(len(rows))))
            columns[name] = columns[name][last]
            is_complete &= last >= 0
    columns = {name: x[is_complete] for name, x in columns.items()}
    is_missing = np.any(list(few_missing.values()), axis=0)
    note = (
        f"{is_missing.sum()} rows lack a number ({', '.join(few_missing)}), first in "
        f"{trial.row_word} {trial.lines[np.argmax(is_missing)]}: what is missing is not used"
    )
    return replace(
        trial, columns=columns, lines=trial.lines[is_complete], notes=(*trial.notes, note)
    )


def _decode_words(raw: Sequence[RawTrial]) -> tuple[list[RawTrial], tuple[str, ...]]:
    """The trials with words of registers as the numbers that they mean, and a note on each. A
    target, which may leap, is in words as its angle is.
    """
    columns = [dict(trial.columns) for trial in raw]
    roles = {name: column_role for name in columns[0] if (column_role := role(name))}
    angles = {
        column_role.joint: name for name, column_role in roles.items() if column_role.stem == "q"
    }
    notes = []
    for name, column_role in roles.items():
        word_column = angles.get(column_role.joint) if column_role.stem == "target" else name
        if word_column is None or column_role.stem not in ("q", "v", "tau", "target"):
            continue
        word = word_of(
            [trial.columns[word_column] for trial in raw if word_column in trial.columns]
        )
        if word:
            notes.append(f"column {name}: whole numbers leap: {word}")
            for trial_columns in (
                trial_columns for trial_columns in columns if name in trial_columns
            ):
                trial_columns[name] = WORDS[word](trial_columns[name])
    pairs = zip(raw, columns, strict=True)
    return [replace(trial, columns=trial_columns) for trial, trial_columns in pairs], tuple(notes)


def _names_in(trial: RawTrial) -> ModelNames:
    """The joints that a trial's own angle columns name, in their order."""
    roles = [role(name) for name in trial.columns]
    angles = [r.joint for r in roles if r and r.stem == "q"]
    if any(isinstance(joint, str) for joint in angles):
        joints = tuple(joint if isinstance(joint, str) else f"joint{joint}" for joint in angles)
    else:
        joints = tuple(f"joint{i}" for i in range(1, len(angles) + 1))
    if not joints:
        raise BadInput(
            f"{trial.path}: has no angle column; add q1, q2, ... or q_NAME (rad), or name them by "
            "[columns]"
        )
    return ModelNames(joints)


def _check_named(
    meta: LogMeta,
    key: str,
    names: Iterable[str],
    valid: Sequence[str],
    problem: str,
    suggested_from: Sequence[str] | None = None,
) -> None:
    """BadInput at the first name under a key of meta.toml that is none of `valid`.

    Args:
        meta: Of the log.
        key: As it is called in the message.
        names: The names that stand there.
        valid: Those that may.
        problem: What another one is.
        suggested_from: Among which the nearest is suggested, `valid` where None.
    """
    for name in names:
        if name not in valid:
            others = valid if suggested_from is None else suggested_from
            raise BadInput(f"{meta.path}: {key} names {name!r}, {problem}; {suggest(name, others)}")


def _check_meta_names(names: ModelNames, raw: list[RawTrial], meta: LogMeta) -> None:
    columns = [name for trial in raw for name in trial.columns]
    valid = (*names.joints, *dict.fromkeys(columns), "q", "")
    for key, declared in (
        ("convention", meta.convention),
        ("zero", meta.zero),
        ("reversed", meta.reversed),
    ):
        suggested_from = (*names.joints, *(c for c in dict.fromkeys(columns) if c.startswith("q")))
        _check_named(
            meta, f"angles.{key}", declared, valid, "no joint and no column", suggested_from
        )
    for key, declared in (("rate", meta.rate), ("within", meta.within)):
        _check_named(meta, f"commands.{key}", declared, names.joints, "no joint")
    quantities = ("time", "angle", "velocity", "torque", "length", "force", "voltage", "current")
    stems = ("q", "v", "tau", "target", "ctrl", "u", "i", "tau_commanded")
    words = {w for name in dict.fromkeys(columns) for w in _words(name, names)}
    valid_keys = (*quantities, *stems, *sorted(words))
    what = "no column, joint or quantity of the data"
    _check_named(meta, "[units]", meta.units, valid_keys, what)
    _check_named(meta, "[noise]", meta.noise, valid_keys, what)


def _words(name: str, names: ModelNames) -> tuple[str, ...]:
    column_role = role(name, names.joints)
    if column_role is None or column_role.stem in ("time", "trial", "base", "channel"):
        return (name,)
    if isinstance(column_role.joint, str):
        return column_role.words(name, column_role.joint)
    index = (column_role.joint or 1) - 1
    joint = names.joints[index] if 0 <= index < len(names.joints) else ""
    return column_role.words(name, joint)


def _trial(
    columns: JointColumns, names: ModelNames, meta: LogMeta, inputs: Inputs, moving: Sequence[int]
) -> LogTrial:
    raw, n, indices = columns.raw, len(names.joints), np.asarray(moving, int)
    angles = columns.by_joint.get("q", {})
    for j in moving:
        if not np.isfinite(angles[j]).any():
            joint = names.joints[j]
            raise BadInput(
                f"{raw.path}: the angle of joint '{joint}' holds no number in any row; record it, "
                f"or write [hold] and {joint} = 0.0 in meta.toml"
            )
    speeds = columns.by_joint.get("v", {})
    if not set(speeds) & set(moving):
        speeds = {}
    if speeds and not set(moving) <= set(speeds):
        missing_joint = next(names.joints[j] for j in moving if j not in speeds)
        raise BadInput(
            f"{raw.path}: has velocities, but none of joint '{missing_joint}'; add column "
            f"v_{missing_joint}, or leave all out"
        )
    q = model_angles(columns.joint_array("q", n), names, meta)[:, indices]
    if speeds:
        v = model_angles(columns.joint_array("v", n), names, meta, rates=True)[:, indices]
    else:
        v = None
    extra = {
        stem: columns.joint_array(stem, n)
        for stem in columns.by_joint
        if stem not in ("q", "v", inputs.stem)
    }
    if "target" in extra:
        extra["target"] = model_angles(extra["target"], names, meta)
    extra = {stem: values[:, indices] for stem, values in extra.items()}
    extra = {stem: values for stem, values in extra.items() if not np.isnan(values).all()}
    return LogTrial(
        name=raw.name,
        path=raw.path,
        time=columns.time,
        q=q,
        v=v,
        u=inputs.of(columns, names, meta, indices),
        extra=extra,
        base=columns.base,
        channels=columns.channels,
    )


def _cut_pauses(trials: tuple[LogTrial, ...]) -> tuple[tuple[LogTrial, ...], tuple[str, ...]]:
    """The trials cut where their clock pauses, and a note on it; what is too short is left out."""
    out, notes = [], []
    for trial in trials:
        pauses = np.flatnonzero(np.diff(trial.time) > TABLE.min_pause)
        ends = [0, *(pauses + 1).tolist(), len(trial.time)]
        parts = [trial.rows(a, b) for a, b in pairwise(ends) if b - a >= TABLE.min_rows]
        if len(ends) == 2 or not parts:
            out.append(trial)
            continue
        out += [replace(part, name=f"{trial.name}_{k}") for k, part in enumerate(parts, 1)]
        notes.append(
            f"{trial.name} pauses for {float(np.max(np.diff(trial.time))):.4g} s: taken as "
            f"{len(parts)} trial(s), {trial.name}_1 to {trial.name}_{len(parts)}"
        )
    return tuple(out), tuple(notes)


TIME_PARTS = 64.0  # smallest parts of a number of a clock's size, that rows are apart at least


def _check_clocks(raw: Sequence[RawTrial], trials: Sequence[LogTrial]) -> None:
    """BadInput at a time that is so far off that those of other rows are one time beside it."""
    for source, trial in zip(raw, trials, strict=True):
        steps = np.diff(trial.time)
        if np.all(steps > TIME_PARTS * np.spacing(np.max(np.abs(trial.time)))):
            continue
        row = int(np.argmax(np.abs(steps)))
        raise BadInput(
            f"{source.path}: {source.row_word} {source.lines[row]}: its time is "
            f"{abs(steps[row]):.3g} s from that of the next row, so far that other rows have one "
            "time; mend or take out that row"
        )


def _even_rows(trials: tuple[LogTrial, ...]) -> tuple[tuple[LogTrial, ...], tuple[str, ...]]:
    """The trials at even times where their rows were read evenly and only stamped unevenly, and a
    note on it.
    """
    row_jitter = jitter([(t.time, t.q) for t in trials])
    if row_jitter is None:
        return _fill_holes(trials)
    step = float(np.median([np.median(np.diff(time)) for time in row_jitter.times]))
    note = (
        f"stamps of rows jitter (by {1e3 * row_jitter.size:.2g} ms) and the angles do not "
        f"({100 * row_jitter.share:.0f} % of it is not in them): rows are taken as read evenly, "
        f"every {1e3 * step:.4g} ms"
    )
    return tuple(replace(t, time=time) for t, time in zip(trials, row_jitter.times, strict=True)), (
        note,
    )


def _fill_holes(trials: tuple[LogTrial, ...]) -> tuple[tuple[LogTrial, ...], tuple[str, ...]]:
    """The trials with empty rows where rows are missing that even stamps deny, and a note on it.
    What acts there is straight between its rows.
    """
    inputs = [t.u if t.v is None else np.concatenate([t.u, t.v], 1) for t in trials]
    missing_rows = holes([(t.time, t.q, x) for t, x in zip(trials, inputs, strict=True)])
    if missing_rows is None:
        return trials, ()
    first = next(k for k, missing in enumerate(missing_rows) if missing.any())
    at = trials[first].time[np.argmax(missing_rows[first] > 0)]
    note = (
        f"rows are missing though stamps are even: {sum(map(np.count_nonzero, missing_rows))} "
        "holes, "
        f"{sum(map(int, map(np.sum, missing_rows)))} rows in all, first in {trials[first].name} "
        "after "
        f"{at:.4g} s, where angles jump as over a longer step; rows are taken to be there, empty"
    )
    return tuple(_with_rows(t, missing) for t, missing in zip(trials, missing_rows, strict=True)), (
        note,
    )


def _with_rows(trial: LogTrial, missing: np.ndarray) -> LogTrial:
    """A trial with so many rows after each `[T - 1]`, in which nothing was read."""
    old_rows = np.concatenate([[0], np.cumsum(1 + missing)])
    new_rows = np.arange(old_rows[-1] + 1)

    def interpolate(x):
        return np.stack([np.interp(new_rows, old_rows, column) for column in x.T], 1)

    def spread(x):
        out = np.full((len(new_rows), *x.shape[1:]), np.nan)
        out[old_rows] = x
        return out

    return replace(
        trial,
        time=trial.time[0] + trial.dt * new_rows,
        q=spread(trial.q),
        v=None if trial.v is None else spread(trial.v),
        u=interpolate(trial.u) if trial.u.size else np.zeros((len(new_rows), trial.u.shape[1])),
        extra={name: interpolate(x) for name, x in trial.extra.items()},
        base=None if trial.base is None else interpolate(trial.base),
        channels={name: spread(x) for name, x in trial.channels.items()},
    )


def _notes(raw: Sequence[RawTrial], trials: Sequence[LogTrial]) -> tuple[str, ...]:
    notes = list(dict.fromkeys(note for trial in raw for note in trial.notes))
    ignored = sorted({column for trial in raw for column in trial.ignored if column.strip()})
    if ignored:
        notes.append(f"columns ignored: {', '.join(ignored)}")
    extra_columns = sorted({stem for trial in trials for stem in trial.extra})
    if extra_columns:
        notes.append(f"columns kept beside the input: {', '.join(extra_columns)}")
    if any(trial.v is None for trial in trials):
        notes.append(
            "some trials have no velocities"
            if any(t.v is not None for t in trials)
            else "no velocities logged"
        )
    missing = {
        trial.name: int(np.isnan(trial.q).sum()) for trial in trials if np.isnan(trial.q).any()
    }
    if missing:
        notes.append(
            f"angles missing: {', '.join(f'{count} in {name}' for name, count in missing.items())}"
        )
    return tuple(notes)
