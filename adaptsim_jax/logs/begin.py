"""A first `meta.toml` for data of any kind: what can be read, what is guessed, what is left to a
person.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.files import write_bytes
from adaptsim_jax.logs import command_files, lerobot, readers, ros
from adaptsim_jax.logs.archive import stem_and_place
from adaptsim_jax.logs.beside import instead, strays
from adaptsim_jax.logs.columns import NANOS, TIME, TRIAL, roles_of
from adaptsim_jax.logs.declared import SHORT_TRIALS
from adaptsim_jax.logs.guess import Draft, Guess, array_name, guess, is_clock, meta_text
from adaptsim_jax.logs.inputs import PREFERRED, STEM
from adaptsim_jax.logs.log import Log, ModelNames
from adaptsim_jax.logs.read import META, names_of, read_log
from adaptsim_jax.logs.readers import Wanted
from adaptsim_jax.logs.table import read_table
from adaptsim_jax.logs.table_clocks import (
    cut_at_restarts,
    cut_at_steps_back,
    find_time_parts,
    join_time_parts,
    trial_column,
)
from adaptsim_jax.logs.tables import (
    ENDINGS,
    cells_of,
    column_names,
    csv_rows,
    headers_of,
    list_columns,
    table_files,
)

MODELS = (".xml", ".mjcf", ".urdf")


@dataclass(frozen=True)
class WrittenMeta:
    """What was written where: `path` of meta.toml, its `text`; the `log` as it reads now, or what
    is `to_mend` before it does.

    `unused`: columns that nothing was made of.
    """

    path: Path
    text: str
    log: Log | None
    to_mend: str
    unused: tuple[str, ...] = ()


def begin(
    data: Path, out: Path | None, model: Path | None, topics: dict[str, str | Sequence[str]]
) -> WrittenMeta:
    """Write `meta.toml` into `out` (None: into `data`, a folder). Raises `BadInput` where there is
    one, or no data.
    """
    folder = _folder(data, out)
    file = model or _only_model(data)
    names = names_of(str(file))[1] if model else _names_in_folder(file)
    tables = _state_files(data)
    columns, ros_topics, chosen_topics = _columns(
        data, tables, topics, names.joints if names else ()
    )
    if tables:
        columns, clock = _one_clock(tables[0], columns)
    else:
        columns, clock = (columns, {})
    arrays = next(map(_lists, tables), {})
    array_of = {ours: array for array, ours in arrays.items() if ours}
    heading_units = csv_rows(tables[0], 2).units if tables and tables[0].suffix != ".npz" else {}
    is_set = lerobot.is_lerobot(data) if data.is_dir() else False
    guessed = guess(columns, names, is_set, array_of, heading_units)
    renames = {ours: array for ours, array in array_of.items() if ours != array}
    ignored = [name for name in guessed.ignored if name.strip()]
    ignored += [array for array, ours in arrays.items() if not ours]
    guessed = replace(guessed, columns=guessed.columns | clock | renames, ignored=tuple(ignored))
    base_folder = folder.resolve()
    files = table_files(data) if data.is_dir() else []
    commands = {trial: path.name for trial, path in command_files.find_command_files(files).items()}
    draft = Draft(
        model=_relative_path(file, base_folder) if file else None,
        data=None if base_folder == data.resolve() else _relative_path(data, base_folder),
        names=names,
        topics=ros_topics,
        ros=chosen_topics,
        kinds=_kinds(guessed, columns, names),
        commands=commands,
    )
    text = meta_text(guessed, draft)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / META
    write_bytes(path, text.encode())
    try:
        return WrittenMeta(path, text, read_log(folder, names), "", guessed.ignored)
    except BadInput as error:
        return WrittenMeta(path, text, None, error.coded, guessed.ignored)


def _folder(data: Path, out: Path | None) -> Path:
    """The folder that meta.toml goes to. Never one that has it, nor the data's own unless nothing
    else is named.
    """
    if not data.exists():
        raise BadInput(f"{data}: does not exist; give a folder or a file of recordings")
    if (data / "actions.csv").exists() and not (data / META).exists():
        raise BadInput(f"{data / META}: {SHORT_TRIALS}")
    if out is None and not data.is_dir():
        raise BadInput(f"{data}: is a file; name a folder for meta.toml by --out")
    if (
        out is not None
        and data.is_dir()
        and data.resolve() in (out.resolve(), *out.resolve().parents)
    ):
        raise BadInput(
            f"{out}: lies in the data's folder; leave --out away to write there, or name a folder "
            "elsewhere"
        )
    if out is not None and out.exists() and not out.is_dir():
        raise BadInput(f"{out}: is a file; name a folder by --out")
    folder = data if out is None else out
    if (folder / META).exists():
        raise BadInput(
            f"{folder / META}: is there already; mend it by hand, or name another folder by --out"
        )
    return folder


def _only_model(data: Path) -> Path | None:
    """The one MJCF or URDF file beside the data, if there is one."""
    if not data.is_dir():
        return None
    models = [p for p in data.iterdir() if p.suffix.lower() in MODELS and p.is_file()]
    if len(models) == 1:
        return models[0]
    return None


def _names_in_folder(model: Path | None) -> ModelNames | None:
    """What a model file that nobody named has; None where it cannot be read."""
    try:
        if model:
            return names_of(str(model))[1]
        return None
    except BadInput:
        return None


def _relative_path(path: Path, folder: Path) -> str:
    return Path(os.path.relpath(path.resolve(), folder)).as_posix()


def _columns(
    data: Path,
    tables: list[Path],
    topics: dict[str, str | Sequence[str]],
    joints: Sequence[str],
) -> tuple[dict[str, np.ndarray], list[str], dict[str, str | Sequence[str]]]:
    """Columns of the first trial as its file names them; of bags also what their topics are, and
    those that are chosen.
    """
    if data.is_dir() and lerobot.is_lerobot(data):
        trial = lerobot.read_lerobot(data, Wanted())[0]
        # numbers whose names do not fit are no joints until a person says which
        columns = {
            n: x
            for n, x in trial.columns.items()
            if not any(n.startswith(f"{v}[") for v in trial.name_problems)
        }
        return columns, [], {}
    if tables:
        return _table_columns(tables[0]), [], {}
    bags = ros.bags(data)
    if not bags and (readers_here := readers.found(data)):
        reader, path = readers_here[0]
        return reader.read(path, Wanted(joints=tuple(joints)))[0].columns, [], {}
    if not bags:
        formats = f"{', '.join((*ENDINGS, *readers.endings()))}, or a LeRobot data set"
        raise BadInput(f"{data}: holds no recordings ({formats}){instead(data)}")
    bag_topics, chosen_topics = ros.bag_topics(bags[0], topics, joints)
    lines = [f"{topic.name}: {topic.kind}, {topic.count} messages" for topic in bag_topics]
    return ros.read_bag(bags[0], Wanted(topics | chosen_topics)).columns, lines, chosen_topics


def _one_clock(
    path: Path, columns: dict[str, np.ndarray]
) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Return the columns of the first trial alone, with one time; and our name -> the file's of
    columns that are recognised together: the two parts of a time, and what names the trials where
    the clock starts again.
    """
    renames: dict[str, str] = {}
    if TIME[0] not in columns and (time_parts := find_time_parts(columns)):
        time = join_time_parts(columns[time_parts[0]], columns[time_parts[1]])
        columns = {TIME[0]: time} | {
            name: values for name, values in columns.items() if name not in time_parts
        }
        renames = dict(zip((TIME[0], NANOS), time_parts, strict=True))
    restarting = (
        x
        for name, x in columns.items()
        if is_clock(name) and np.all(np.isfinite(x)) and np.any(np.diff(x) < 0)
    )
    time = next(restarting, None)
    if time is None or any(name in TRIAL for name in column_names(path)):
        return columns, renames
    label_column = trial_column(cells_of(path), time)
    parts = cut_at_steps_back(time) if label_column else cut_at_restarts(time)
    if parts:
        columns = {
            name: x[parts[0]]
            for name, x in columns.items()
            if name != label_column and len(x) == len(time)
        }
    return columns, renames | ({"trial": label_column} if label_column else {})


def _state_files(data: Path) -> list[Path]:
    """Tables of the data from the first that holds numbers on, without those that seem to hold
    commands of another, or no trial.
    """
    if data.is_dir() and lerobot.is_lerobot(data):
        return []
    files = table_files(data)
    excluded = {*command_files.find_command_files(files).values()}
    if len(files) > 1:
        headers = headers_of(files)
        parts = {name for header in headers.values() for name in find_time_parts(header) or ()}
        excluded |= {*strays(headers, lambda name: is_clock(name) or name in parts)}
    files = [path for path in files if path not in excluded]
    if len(files) > 1:
        first = next((k for k, path in enumerate(files) if _holds_numbers(path)), 0)
    else:
        first = 0
    return files[first:]


def _holds_numbers(path: Path) -> bool:
    try:
        return bool(_table_columns(path))
    except BadInput:
        return False


def _lists(path: Path) -> dict[str, str | None]:
    """Lists and arrays `[T, n]` of a file, by name: what each seems to be to us (`q` gives q1 to
    qn), None where nothing.
    """
    stem_of: dict[str, str | None] = {}
    for name in list_columns(path):
        ours = array_name(name)
        stem_of[name] = None if ours in stem_of.values() else ours
    return stem_of


def _table_columns(path: Path) -> dict[str, np.ndarray]:
    """Every column of numbers; others are left out. A list or an array `[T, n]` of joints is n
    columns by our name of it.
    """
    names = tuple(dict.fromkeys(column_names(path)))
    try:
        return _expand_lists(read_table(path, names, ours={}).columns, path)
    except BadInput as error:
        out = {}
        # one column of words must not hide the others, nor cells that another topic leaves empty
        for name in names:
            try:
                out |= read_table(path, (name,), ours={}, gaps=(name,)).columns
            except BadInput:
                continue
        if not out:
            raise error
        return _expand_lists(out, path)


def _expand_lists(columns: dict[str, np.ndarray], path: Path) -> dict[str, np.ndarray]:
    """Name places of lists by our name of these; lists that seem to be nothing are left out."""
    lists = _lists(path)
    out = {}
    for name, values in columns.items():
        part = stem_and_place(name)
        if part is None or part[0] not in lists:
            out[name] = values
        elif ours := lists[part[0]]:
            out[f"{ours}{part[1] + 1}"] = values
    return out


def _kinds(guessed: Guess, columns: dict[str, np.ndarray], names: ModelNames | None) -> list[str]:
    """The input kinds that the columns allow: those that columns name themselves first, then by
    preference.
    """
    file_names = set(guessed.columns.values()) | set(guessed.ignored)

    def kinds_of(ours: Iterable[str]) -> list[str]:
        stems = {r.stem for r in roles_of(ours, names.joints if names else ()).values()}
        return [
            kind
            for kind in PREFERRED
            if STEM[kind] in stems or (kind == "command" and "ctrl" in stems)
        ]

    return list(
        dict.fromkeys(
            [
                *kinds_of(name for name in columns if name not in file_names),
                *kinds_of(guessed.columns),
            ]
        )
    )
