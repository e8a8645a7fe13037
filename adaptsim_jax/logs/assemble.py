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
    raw = [counted(trial) for trial in _selected(path, raw, meta)]
    raw = [_without_ignored(trial, meta, model) for trial in raw]
    raw = [_without_missing(trial, meta) for trial in raw]
    raw, worded = _decoded(raw)
    raw = [read_once(trial) for trial in raw]
    names = model or _names_in(raw[0])
    _check_meta_names(names, raw, meta)
    trials = [columns_of(trial, names, meta) for trial in raw]
    scales = check_scales(trials, names)
    retained, held = _moving(path, trials, names, meta)
    inputs = choose_inputs(trials, names, meta, [names.joints[j] for j in retained])
    log_trials = tuple(_trial(columns, names, meta, inputs, retained) for columns in trials)
    _check_clocks(raw, log_trials)
    log_trials, paused = _unpaused(log_trials)
    log_trials, evened = _evened(log_trials)
    headed = tuple(dict.fromkeys(note for columns in trials for note in columns.notes))
    known = {names.joints[j] for columns in trials for j in columns.declared}
    written = {
        names.joints[j]: Written(*(trials[0].named[s, j] for s in ("q", "v")), scale)
        for (stem, j), scale in trials[0].scale.items()
        if stem == "v" and j in retained
    }
    moving = names.only(retained)
    suspected = headed + scales + check_log_units(log_trials, moving, meta.units, known, written)
    turns = [columns.raw.name for columns in trials if columns.turns]
    if turns:
        turned = (
            f"jumps of whole turns taken out of the angles (and targets) of {', '.join(turns)}",
        )
    else:
        turned = ()
    notes = (
        inputs.notes
        + worded
        + _strange(raw[0], names, held)
        + _numbered(raw[0], names, retained)
        + _notes(raw, log_trials)
    )
    repeated = copies([(t.name, t.q) for t in log_trials])
    return Log(
        path=path,
        meta=meta,
        joint_names=tuple(names.joints[j] for j in retained),
        trials=log_trials,
        input_kind=inputs.kind,
        input_names=inputs.names,
        driven=inputs.driven,
        input_columns=_input_columns(raw[0], names, inputs),
        notes=notes + turned + paused + evened + suspected + repeated + unread(path),
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
    n, have = len(names.joints), trials[0].by_joint.get("q", {})
    if not n:
        if any(columns.base is None and not columns.channels for columns in trials):
            raise BadInput(
                f"{path}: the model has no joint but its base's; log base_x, base_y, base_z (m) "
                "and base_qw .. base_qz"
            )
        return [], {}
    _check_angles(trials, names, meta)
    angles = [model_angles(columns.stacked("q", n), names, meta) for columns in trials]
    every = np.concatenate(angles)
    some: np.ndarray = np.any(np.isfinite(every), axis=0)
    retained, held = [], {}
    for j, joint in enumerate(names.joints):
        angle = every[:, j]
        middle = float(np.nanmedian(angle)) if some[j] else None
        still = some[j] and float(np.nanmax(angle) - np.nanmin(angle)) == 0.0
        if joint in meta.hold:
            given = meta.hold[joint]
            held[joint] = middle if given is None else given
        elif j not in have:
            held[joint] = None
        elif still and meta.rig is None:  # of a pendulum a sensor is stuck then
            held[joint] = middle
        else:
            retained.append(j)
    if not retained:
        raise BadInput(f"{path}: no joint moves in any trial; log one that does")
    return retained, held


def _check_angles(trials: list[JointColumns], names: ModelNames, meta: LogMeta) -> None:
    """BadInput where a trial lacks the angle of a joint that others, or its own columns, have."""
    have = [columns.by_joint.get("q", {}) for columns in trials]
    for columns, here in zip(trials, have, strict=True):
        if not here:
            _no_angle(columns, names, 0, here)
        moves = {
            j
            for rows in columns.by_joint.values()
            for j, x in rows.items()
            if len(np.unique(x[np.isfinite(x)])) > 1
        }
        for j in sorted(set().union(*have, moves) - set(here)):
            if names.joints[j] not in meta.hold:
                _no_angle(columns, names, j, here)


def _no_angle(
    columns: JointColumns, names: ModelNames, j: int, here: Mapping[int, np.ndarray]
) -> None:
    raw, joint = columns.raw, names.joints[j]
    if not here:
        raise BadInput(
            f"{raw.path}: has no angles; add columns q1 or q_{joint}, one for each "
            f"joint{also_there(raw, 'q', joint)}"
        )
    have = [names.joints[k] for k in here]
    mend = (
        f"record it in every trial, or write [hold] and {joint} = 0.0 in meta.toml, in rad or m "
        f"(this trial has {', '.join(have)})"
    )
    raise BadInput(
        f"{raw.path}: no angle of the model's joint '{joint}' (column q{j + 1} or q_{joint}); "
        f"{mend}"
    )


def _strange(
    trial: RawTrial, names: ModelNames, held: Mapping[str, float | None]
) -> tuple[str, ...]:
    """A joint that nothing was logged of beside angles that no joint of the model has: the same by
    another name?
    """
    bare = [name for name, value in held.items() if value is None]
    left = [n for n, r in roles_of(trial.ignored, names.joints).items() if r.stem == "q"]
    if not bare or not left:
        return ()
    return (
        f"nothing is logged of {', '.join(bare)}, held; {', '.join(left)} is left out: if it is "
        "the same, name it by [columns]",
    )


def _numbered(trial: RawTrial, names: ModelNames, retained: Sequence[int]) -> tuple[str, ...]:
    """Which joints columns that go by number are taken for, where the model has more."""
    roles = roles_of(trial.columns, names.joints).values()
    numbered = any(r.stem == "q" and isinstance(r.joint, int) for r in roles)
    if len(retained) == len(names.joints) or not numbered:
        return ()
    return (
        "columns go by number, in the model's order of joints: "
        f"{', '.join(names.joints[j] for j in retained)}",
    )


def _input_columns(trial: RawTrial, names: ModelNames, inputs: Inputs) -> tuple[str, ...]:
    """The column that each input was read from, empty where there is none."""
    if inputs.kind == "command":
        stems = ("ctrl", "target")
    else:
        stems = (inputs.stem,)
    every = roles_of(trial.columns, names.joints)
    roles = {name: r for name, r in every.items() if r.stem in stems}
    base = 0 if any(r.joint == 0 for r in every.values()) else 1
    place = {joint: k + base for k, joint in enumerate(names.joints)}
    out = []
    for index, name in enumerate(inputs.names):
        joint = inputs.actuators[index].joint if inputs.actuators else name
        own = {"ctrl": (name, joint, index + base)}
        of_joint = (joint, place.get(joint))
        mine = sorted((r.stem, c) for c, r in roles.items() if r.joint in own.get(r.stem, of_joint))
        out.append(mine[0][1] if mine else "")
    return tuple(out)


def _selected(path: str, raw: list[RawTrial], meta: LogMeta) -> list[RawTrial]:
    names = [trial.name for trial in raw]
    there = [pattern for pattern in meta.exclude if fnmatch.filter(names, pattern)]
    _check_named(meta, "trials.exclude", meta.exclude, there, f"no trial of {path}", names)
    retained = [
        trial for trial in raw if not any(fnmatch.fnmatchcase(trial.name, p) for p in meta.exclude)
    ]
    if not retained:
        raise BadInput(f"{meta.path}: trials.exclude leaves no trial; keep one")
    short = [trial.name for trial in retained if len(trial.lines) < TABLE.min_rows]
    long = [trial for trial in retained if trial.name not in short]
    if not long:
        raise BadInput(
            f"{path}: {short[0]} has {len(retained[0].lines)} rows; a trial needs at least "
            f"{TABLE.min_rows}"
        )
    if not short:
        return retained
    note = f"fewer than {TABLE.min_rows} rows, left out: {', '.join(short)}"
    return [replace(long[0], notes=(*long[0].notes, note)), *long[1:]]


def _without_ignored(trial: RawTrial, meta: LogMeta, model: ModelNames | None) -> RawTrial:
    """The trial without columns that are not ours, and those that `ignore` names: themselves, or by
    their joint.
    """
    joints = model.joints if model else ()
    ours = {
        n: v
        for n, v in trial.columns.items()
        if role(n, joints) and not is_ignored(n, meta.ignore, joints)
    }
    gone = tuple(name for name in trial.columns if name not in ours)
    return replace(trial, columns=ours, ignored=(*trial.ignored, *gone))


def _without_missing(trial: RawTrial, meta: LogMeta) -> RawTrial:
    """The trial where a few rows lack numbers, or a register did not answer: what acts, acts on
    from the row before; rows without a pose or a sensor are left out, and those before anything
    acts. Angles and speeds are NaN, but for a pendulum, whose rows are whole.
    """
    lacks = {name: np.isnan(x) | unanswered(x) for name, x in trial.columns.items()}
    some = {name: rows for name, rows in lacks.items() if 0 < rows.mean() <= TABLE.few}
    if not some:
        return trial
    columns, whole = dict(trial.columns), np.ones(len(trial.lines), bool)
    for name, rows in some.items():
        columns[name] = np.where(rows, np.nan, columns[name])
        found = role(name)
        if meta.rig is not None or (found and found.stem in ("time", "base", "channel")):
            whole &= ~rows
        elif found is None or found.stem not in ("q", "v"):
            last = np.maximum.accumulate(np.where(rows, -1, np.arange(len(rows))))
            columns[name] = columns[name][last]
            whole &= last >= 0
    columns = {name: x[whole] for name, x in columns.items()}
    every = np.any(list(some.values()), axis=0)
    note = (
        f"{every.sum()} rows lack a number ({', '.join(some)}), first in {trial.row_word} "
        f"{trial.lines[np.argmax(every)]}: what is missing is not used"
    )
    return replace(trial, columns=columns, lines=trial.lines[whole], notes=(*trial.notes, note))


def _decoded(raw: Sequence[RawTrial]) -> tuple[list[RawTrial], tuple[str, ...]]:
    """The trials with words of registers as the numbers that they mean, and a note on each. A
    target, which may leap, is in words as its angle is.
    """
    columns = [dict(trial.columns) for trial in raw]
    roles = {name: found for name in columns[0] if (found := role(name))}
    angles = {found.joint: name for name, found in roles.items() if found.stem == "q"}
    notes = []
    for name, found in roles.items():
        leads = angles.get(found.joint) if found.stem == "target" else name
        if leads is None or found.stem not in ("q", "v", "tau", "target"):
            continue
        how = word_of([trial.columns[leads] for trial in raw if leads in trial.columns])
        if how:
            notes.append(f"column {name}: whole numbers leap: {how}")
            for own in (own for own in columns if name in own):
                own[name] = WORDS[how](own[name])
    pairs = zip(raw, columns, strict=True)
    return [replace(trial, columns=own) for trial, own in pairs], tuple(notes)


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
    given: Iterable[str],
    known: Sequence[str],
    what: str,
    near: Sequence[str] | None = None,
) -> None:
    """BadInput at the first name under a key of meta.toml that is none of `known`.

    Args:
        meta: Of the log.
        key: As it is called in the message.
        given: The names that stand there.
        known: Those that may.
        what: What another one is.
        near: Among which the nearest is suggested, `known` where None.
    """
    for name in given:
        if name not in known:
            others = known if near is None else near
            raise BadInput(f"{meta.path}: {key} names {name!r}, {what}; {suggest(name, others)}")


def _check_meta_names(names: ModelNames, raw: list[RawTrial], meta: LogMeta) -> None:
    columns = [name for trial in raw for name in trial.columns]
    known = (*names.joints, *dict.fromkeys(columns), "q", "")
    for key, given in (
        ("convention", meta.convention),
        ("zero", meta.zero),
        ("reversed", meta.reversed),
    ):
        near = (*names.joints, *(c for c in dict.fromkeys(columns) if c.startswith("q")))
        _check_named(meta, f"angles.{key}", given, known, "no joint and no column", near)
    for key, given in (("rate", meta.rate), ("within", meta.within)):
        _check_named(meta, f"commands.{key}", given, names.joints, "no joint")
    quantities = ("time", "angle", "velocity", "torque", "length", "force", "voltage", "current")
    stems = ("q", "v", "tau", "target", "ctrl", "u", "i", "tau_commanded")
    words = {w for name in dict.fromkeys(columns) for w in _words(name, names)}
    every = (*quantities, *stems, *sorted(words))
    what = "no column, joint or quantity of the data"
    _check_named(meta, "[units]", meta.units, every, what)
    _check_named(meta, "[noise]", meta.noise, every, what)


def _words(name: str, names: ModelNames) -> tuple[str, ...]:
    found = role(name, names.joints)
    if found is None or found.stem in ("time", "trial", "base", "channel"):
        return (name,)
    if isinstance(found.joint, str):
        return found.words(name, found.joint)
    index = (found.joint or 1) - 1
    joint = names.joints[index] if 0 <= index < len(names.joints) else ""
    return found.words(name, joint)


def _trial(
    columns: JointColumns, names: ModelNames, meta: LogMeta, inputs: Inputs, retained: Sequence[int]
) -> LogTrial:
    raw, n, at = columns.raw, len(names.joints), np.asarray(retained, int)
    here = columns.by_joint.get("q", {})
    for j in retained:
        if not np.isfinite(here[j]).any():
            joint = names.joints[j]
            raise BadInput(
                f"{raw.path}: the angle of joint '{joint}' holds no number in any row; record it, "
                f"or write [hold] and {joint} = 0.0 in meta.toml"
            )
    speeds = columns.by_joint.get("v", {})
    if not set(speeds) & set(retained):
        speeds = {}
    if speeds and not set(retained) <= set(speeds):
        lacks = next(names.joints[j] for j in retained if j not in speeds)
        raise BadInput(
            f"{raw.path}: has velocities, but none of joint '{lacks}'; add column v_{lacks}, or "
            "leave all out"
        )
    q = model_angles(columns.stacked("q", n), names, meta)[:, at]
    if speeds:
        v = model_angles(columns.stacked("v", n), names, meta, rates=True)[:, at]
    else:
        v = None
    extra = {
        stem: columns.stacked(stem, n)
        for stem in columns.by_joint
        if stem not in ("q", "v", inputs.stem)
    }
    if "target" in extra:
        extra["target"] = model_angles(extra["target"], names, meta)
    extra = {stem: values[:, at] for stem, values in extra.items()}
    extra = {stem: values for stem, values in extra.items() if not np.isnan(values).all()}
    return LogTrial(
        name=raw.name,
        path=raw.path,
        time=columns.time,
        q=q,
        v=v,
        u=inputs.of(columns, names, meta, at),
        extra=extra,
        base=columns.base,
        channels=columns.channels,
    )


def _unpaused(trials: tuple[LogTrial, ...]) -> tuple[tuple[LogTrial, ...], tuple[str, ...]]:
    """The trials cut where their clock pauses, and a note on it; what is too short is left out."""
    out, notes = [], []
    for trial in trials:
        pauses = np.flatnonzero(np.diff(trial.time) > TABLE.pause)
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


def _evened(trials: tuple[LogTrial, ...]) -> tuple[tuple[LogTrial, ...], tuple[str, ...]]:
    """The trials at even times where their rows were read evenly and only stamped unevenly, and a
    note on it.
    """
    found = jitter([(t.time, t.q) for t in trials])
    if found is None:
        return _filled(trials)
    step = float(np.median([np.median(np.diff(time)) for time in found.times]))
    note = (
        f"stamps of rows jitter (by {1e3 * found.size:.2g} ms) and the angles do not "
        f"({100 * found.share:.0f} % of it is not in them): rows are taken as read evenly, every "
        f"{1e3 * step:.4g} ms"
    )
    return tuple(replace(t, time=time) for t, time in zip(trials, found.times, strict=True)), (
        note,
    )


def _filled(trials: tuple[LogTrial, ...]) -> tuple[tuple[LogTrial, ...], tuple[str, ...]]:
    """The trials with empty rows where rows are missing that even stamps deny, and a note on it.
    What acts there is straight between its rows.
    """
    inputs = [t.u if t.v is None else np.concatenate([t.u, t.v], 1) for t in trials]
    found = holes([(t.time, t.q, x) for t, x in zip(trials, inputs, strict=True)])
    if found is None:
        return trials, ()
    first = next(k for k, missing in enumerate(found) if missing.any())
    at = trials[first].time[np.argmax(found[first] > 0)]
    note = (
        f"rows are missing though stamps are even: {sum(map(np.count_nonzero, found))} holes, "
        f"{sum(map(int, map(np.sum, found)))} rows in all, first in {trials[first].name} after "
        f"{at:.4g} s, where angles jump as over a longer step; rows are taken to be there, empty"
    )
    return tuple(_with_rows(t, missing) for t, missing in zip(trials, found, strict=True)), (note,)


def _with_rows(trial: LogTrial, missing: np.ndarray) -> LogTrial:
    """A trial with so many rows after each `[T - 1]`, in which nothing was read."""
    old = np.concatenate([[0], np.cumsum(1 + missing)])
    new = np.arange(old[-1] + 1)

    def straight(x):
        return np.stack([np.interp(new, old, column) for column in x.T], 1)

    def read(x):
        out = np.full((len(new), *x.shape[1:]), np.nan)
        out[old] = x
        return out

    return replace(
        trial,
        time=trial.time[0] + trial.dt * new,
        q=read(trial.q),
        v=None if trial.v is None else read(trial.v),
        u=straight(trial.u) if trial.u.size else np.zeros((len(new), trial.u.shape[1])),
        extra={name: straight(x) for name, x in trial.extra.items()},
        base=None if trial.base is None else straight(trial.base),
        channels={name: read(x) for name, x in trial.channels.items()},
    )


def _notes(raw: Sequence[RawTrial], trials: Sequence[LogTrial]) -> tuple[str, ...]:
    notes = list(dict.fromkeys(note for trial in raw for note in trial.notes))
    ignored = sorted({column for trial in raw for column in trial.ignored if column.strip()})
    if ignored:
        notes.append(f"columns ignored: {', '.join(ignored)}")
    retained = sorted({stem for trial in trials for stem in trial.extra})
    if retained:
        notes.append(f"columns kept beside the input: {', '.join(retained)}")
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
