"""A log read from what people have: a folder with `meta.toml`, CSV or NPZ files, bags, LeRobot data
sets.

Each source gives raw trials of named columns; here they become joints of a model, in SI units. JAX
is imported only where a model is read, so that bad input is reported at once.
"""

from __future__ import annotations

import fnmatch
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from adaptsim_jax.core.config import suggest
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.files import is_pointer
from adaptsim_jax.logs import bag, command_files, readers
from adaptsim_jax.logs.assemble import assemble
from adaptsim_jax.logs.beside import instead
from adaptsim_jax.logs.log import Log, ModelNames, model_names, restrict_log
from adaptsim_jax.logs.log_meta import LogMeta, read_log_meta
from adaptsim_jax.logs.pool import Data, agreed, labelled, labels_of, logs_of
from adaptsim_jax.logs.tables import ENDINGS, RawTrial, read_files, table_files

if TYPE_CHECKING:
    from adaptsim_jax.mechanisms.mjcf import Mechanism
    from adaptsim_jax.mechanisms.spec import Source

META = "meta.toml"
FETCHED = (*ENDINGS, *bag.ENDINGS, ".parquet", ".json", ".jsonl")
"""Endings of files that must hold data; a data set's videos need not be there."""


def read_log(
    source: str | Path,
    model: Sequence[str] | ModelNames | None = None,
    meta: LogMeta | str | Path | None = None,
) -> Log:
    """Read a log.

    Raises `BadInput`, one line that names the file, the row, column or key, and the mend.

    Args:
        source: A folder (with `meta.toml`, else SI units and the usual names are assumed; one CSV
            or NPZ a trial), or one file (CSV, NPZ, a ROS 1 or 2 bag, MCAP), or a LeRobot data set's
            folder.
        model: The joints of the model by name and in order, with `ModelNames` also those that slide
            and the actuators; None: those of the model that meta.toml names, else the data's own
            joints.
        meta: What stands in place of the folder's `meta.toml`, or its path.
    """
    source, meta, notes = _source_and_meta(source, meta)
    if model is not None and not isinstance(model, ModelNames):
        names = ModelNames(tuple(model))
    else:
        names = model
    if names is None and meta.model:
        names = names_of(meta.model)[1]
    return _read(source, names, meta, notes)


def read_with_model(
    source: str | Path, model: str | Path | None = None, meta: LogMeta | str | Path | None = None
) -> tuple[Mechanism, Log]:
    """A log and the mechanism that it is of: `model` (a path, MJCF or URDF), else the one that
    meta.toml names.
    """
    return joined(*read_source_and_log(source, model, meta))


def read_source_and_log(
    source: Data, model: str | Path | None = None, meta: LogMeta | str | Path | None = None
) -> tuple[Source, Log]:
    """Read the model file as it is, and the log of all its joints: of several logs of one machine
    their trials together.
    """
    logs = logs_of(source)
    metas, notes = zip(*(_meta(path, meta) for path in logs), strict=True)
    labels = labels_of(logs) if len(logs) > 1 else ()
    one = agreed(metas, labels, model is not None) if labels else metas[0]
    path = str(model) if model is not None else one.model
    if path is None:
        where = one.path or logs[0]
        raise BadInput(
            f'{where}: no model is named; write model = "robot.xml" in meta.toml, or give one by '
            f"--model"
        )
    file, names = names_of(path)
    if not labels:
        return file, _read(logs[0], names, one, notes[0])
    trials = [
        trial
        for path, own, label in zip(logs, metas, labels, strict=True)
        for trial in labelled(read_raw(Path(own.data or path), own, names), label)
    ]
    log = assemble(", ".join(map(str, logs)), trials, names, one)
    told = tuple(dict.fromkeys(note for some in notes for note in some))
    return file, replace(log, notes=told + log.notes, labels=labels)


def joined(source: Source, log: Log) -> tuple[Mechanism, Log]:
    """The mechanism that moves in a log of a model, and the log of its coordinates."""
    from adaptsim_jax.mechanisms.mjcf import mechanism_of  # loads JAX

    hold = {
        name: value
        for name, value in log.held.items()
        if value is not None or name in log.meta.hold
    }
    mechanism = mechanism_of(source, hold, log.joint_names, log.meta.path)
    return mechanism, restrict_log(log, mechanism)


def _source_and_meta(
    source: str | Path, meta: LogMeta | str | Path | None
) -> tuple[Path, LogMeta, tuple[str, ...]]:
    (path,) = logs_of(source)
    return path, *_meta(path, meta)


def names_of(path: str) -> tuple[Source, ModelNames]:
    """A model file, and what a reader of logs must know of it."""
    from adaptsim_jax.mechanisms.spec import read_source

    source = read_source(path)
    return source, model_names(source)


def _read(source: Path, names: ModelNames | None, meta: LogMeta, notes: tuple[str, ...]) -> Log:
    trials = read_raw(Path(meta.data or source), meta, names)
    log = assemble(str(source), trials, names, meta)
    return replace(log, notes=notes + log.notes)


def _meta(source: Path, given: LogMeta | str | Path | None) -> tuple[LogMeta, tuple[str, ...]]:
    if isinstance(given, LogMeta):
        return given, ()
    path = Path(given) if given is not None else source / META
    if given is not None or (source.is_dir() and path.exists()):
        return read_log_meta(path), ()
    return LogMeta(path=str(path) if source.is_dir() else ""), (
        "no meta.toml: columns taken by their names, in SI units; 'adaptsim init' writes one",
    )


def read_raw(data: Path, meta: LogMeta, names: ModelNames | None = None) -> list[RawTrial]:
    """The raw trials of a file or folder, by what kind it is.

    What is left out is not looked at; a file of one trial is called as its trial.

    Args:
        names: The model's.
    """

    def is_excluded(name: str) -> bool:
        return any(fnmatch.fnmatchcase(name, pattern) for pattern in meta.exclude)

    read_by_others = readers.found(data)
    is_data_set = data.is_dir() and any(path == data for _, path in read_by_others)  # one data set
    files, commands = ([], {}) if is_data_set else _tables(data, meta)
    if not files and not read_by_others:
        raise _no_recordings(data)
    excluded = [
        path
        for path in (*files, *(p for _, p in read_by_others))
        if not is_data_set and is_excluded(_stem(path))
    ]
    files = [path for path in files if path not in excluded]
    read_by_others = [(reader, path) for reader, path in read_by_others if path not in excluded]
    for path in (*files, *(p for _, p in read_by_others)):
        _check_fetched(path)
    wanted = _wanted(meta, names, is_excluded)
    recorded_trials: list[RawTrial] = []
    for reader, path in read_by_others:
        trials = reader.read(path, wanted)
        if not files:  # in a folder of both, [columns] speaks of the tables
            trials = _renamed(trials, meta)
        if reader.check is not None and (first := [t for t in trials if t.columns]):
            reader.check(path, first[0], wanted.joints)
        recorded_trials += trials
    trials = _read_tables(data, files, commands, meta) + recorded_trials
    if len(files) < len(trials) and not is_data_set:
        trials = _named_by_file(trials)
    return trials + [
        RawTrial(_stem(path), str(path), {}, np.zeros(0, np.int64)) for path in excluded
    ]


def _check_fetched(path: Path) -> None:
    """BadInput where a file, or one of a data set, is a pointer of Git LFS."""
    for part in path.rglob("*") if path.is_dir() else (path,):
        if part.suffix in FETCHED and part.is_file() and is_pointer(part):
            raise BadInput(f"{part}: is a pointer of Git LFS, no data; fetch it by 'git lfs pull'")


def _tables(data: Path, meta: LogMeta) -> tuple[list[Path], dict[str, Path]]:
    """The tables of trials, and those that hold commands beside them."""
    folder = data if data.is_dir() else data.parent
    files = table_files(data)
    commands = command_files.command_paths(meta.commands, folder, meta.path)
    files = [path for path in files if path not in commands.values()]
    if not commands and data.is_dir():
        command_files.check_command_files(files)
    return files, commands


def _read_tables(
    data: Path, files: list[Path], commands: dict[str, Path], meta: LogMeta
) -> list[RawTrial]:
    """The trials of these files, with their commands."""
    paths = tuple(commands.values())
    read = read_files(files, meta, paths)
    trials = [command_files.with_commands(t, commands, meta) for t in read]
    if files and not data.is_dir() and not commands:
        notes = command_files.command_file_note(data, table_files(data.parent))
        trials = [replace(trial, notes=(*trial.notes, *notes)) for trial in trials]
    return trials


def _no_recordings(data: Path) -> BadInput:
    ends = (*ENDINGS, *readers.endings())
    if not data.is_dir():
        return BadInput(
            f"{data}: a log ends in {', '.join(ends)}; convert this file, or give its folder"
        )
    return BadInput(
        f"{data}: holds no .csv, .npz, .mcap or .bag file; put one file a trial "
        f"there{instead(data)}"
    )


def _wanted(meta: LogMeta, names: ModelNames | None, out: Callable[[str], bool]) -> readers.Wanted:
    """What readers are asked for."""
    servos = {}
    if names is not None:
        for k, a in enumerate(names.actuators or (), 1):
            if a.kind == "position" and a.joint not in names.slides:
                servos[f"ctrl{k}"] = a.joint
    joints = names.joints if names else ()
    named = tuple(meta.columns.values())
    return readers.Wanted(meta.ros, meta.ignore, joints, named, servos, out)


def _named_by_file(trials: list[RawTrial]) -> list[RawTrial]:
    """The trials, those of one name called by their files."""
    name_counts = Counter(trial.name for trial in trials)
    path_counts = Counter(trial.path for trial in trials)

    def by_file(trial: RawTrial) -> str:
        if path_counts[trial.path] > 1:
            return f"{_stem(Path(trial.path))}_{trial.name}"
        return Path(trial.path).name

    return [replace(t, name=by_file(t)) if name_counts[t.name] > 1 else t for t in trials]


def _stem(path: Path) -> str:
    if path.is_file():
        return path.stem
    return path.name


def _renamed(trials: list[RawTrial], meta: LogMeta) -> list[RawTrial]:
    """The trials with their columns under the names that `[columns]` gives them."""
    ours = {theirs: new for new, theirs in meta.columns.items()}
    for trial in trials:
        for theirs, new in ours.items():
            if trial.columns and theirs not in trial.columns:
                near = suggest(theirs, trial.columns)
                raise BadInput(
                    f"{trial.path}: has no column {theirs!r}, which [columns] gives to {new}; "
                    f"{near}"
                )
    return [
        replace(t, columns={ours.get(name, name): values for name, values in t.columns.items()})
        for t in trials
    ]
