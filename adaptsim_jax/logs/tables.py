"""CSV and NPZ files as raw trials: named columns as written, one trial a file or a `trial` column
in one.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from adaptsim_jax.core.config import suggest
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.archive import STEMS, is_list, read_archive, stem_and_place
from adaptsim_jax.logs.beside import left_out, strays
from adaptsim_jax.logs.columns import COUNTERS, NANOS, TIME, TRIAL, is_ignored, role
from adaptsim_jax.logs.criteria import TABLE
from adaptsim_jax.logs.csv_rows import CsvRows, read_lines, rows_of
from adaptsim_jax.logs.log_meta import LogMeta
from adaptsim_jax.logs.table import LogTable, read_table
from adaptsim_jax.logs.table_checks import check_clock, check_missing
from adaptsim_jax.logs.table_clocks import (
    cut_at_headers,
    cut_at_restarts,
    find_time_parts,
    time_parts_line,
    trial_column,
)

ENDINGS = (".csv", ".npz")
LEAVE_OUT = '[trials] exclude = ["{}"]'
"""What a meta.toml says of a trial to leave out."""
__all__ = [
    "ENDINGS",
    "RawTrial",
    "column_names",
    "read_file",
    "read_files",
    "table_files",
]


@dataclass(frozen=True)
class RawTrial:
    """One trial as its file has it: `columns`: name -> `[T]` float64, no unit applied, NaN where a
    value is missing.

    - `lines [T]`: Line (or row, message) numbers for what is said of a row.
    - `ignored`: Names of columns that are not ours.
    - `name_problems`: Vector -> what is wrong with its names, so that its columns (`vector[0]`,
      ...) are joints only by `[columns]`.
    - `units`: Column -> what a row of units below the header says.
    """

    name: str
    path: str
    columns: dict[str, np.ndarray]
    lines: np.ndarray
    row_word: str = "line"
    ignored: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    name_problems: dict[str, str] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)


def table_files(path: Path) -> list[Path]:
    """The CSV and NPZ files of a folder, by name with numbers in their order; a file of these
    itself.
    """
    files = [
        p
        for p in (path.iterdir() if path.is_dir() else [path])
        if p.suffix.lower() in ENDINGS and p.is_file()
    ]
    files = [p for p in files if p == path or not p.name.startswith((".", "~$"))]
    return sorted(
        files, key=lambda p: [int(s) if s.isdigit() else s for s in re.split(r"(\d+)", p.name)]
    )


def read_files(files: list[Path], meta: LogMeta, others: tuple[Path, ...] = ()) -> list[RawTrial]:
    """Every trial of these files.

    Raises `BadInput` naming file and line.

    Args:
        others: Files of commands, whose columns `[columns]` may name too.
    """
    stems = [path.stem for path in files]
    command_columns = {name for path in others for name in column_names(path)}
    trials, notes = [], []
    for path in files:
        names_here = column_names(path) if command_columns else []
        renames = {
            ours: theirs
            for ours, theirs in meta.columns.items()
            if theirs in names_here or theirs not in command_columns
        }
        name = path.name if stems.count(path.stem) > 1 else path.stem
        try:
            trials += read_file(path, name, replace(meta, columns=renames))
        except BadInput as error:
            if path not in strays(headers_of(files), is_time := _is_time(meta.columns)):
                raise _with_exclusion_hint(error, path, files, is_time, meta) from None
            notes.append(left_out(path))
    if notes:
        return [replace(trials[0], notes=(*trials[0].notes, *notes)), *trials[1:]]
    return trials


def _is_time(rename: Mapping[str, str]) -> Callable[[str], bool]:
    """Whether a column is the time, by its name or by [columns]."""
    named = {theirs for ours, theirs in rename.items() if ours in TIME}
    return lambda name: name in named or name in TIME


def _with_exclusion_hint(
    error: BadInput,
    path: Path,
    files: list[Path],
    is_time: Callable[[str], bool],
    meta: LogMeta,
) -> BadInput:
    """Return the error with how to exclude the file, where it may be none of the trials."""
    exclusion = ("--without {}" if meta.rig else LEAVE_OUT).format(path.stem)
    if len(files) == 1:
        return error
    if str(error).endswith("leave this file out"):
        return BadInput(f"{error}: {exclusion}")
    if any(map(is_time, headers_of([path])[path])):
        return error
    return BadInput(f"{error}; or leave it out: {exclusion}")


def headers_of(files: Iterable[Path]) -> dict[Path, list[str]]:
    """The columns of each file, none of one that cannot be read."""
    out = {}
    for path in files:
        try:
            out[path] = column_names(path)
        except BadInput:
            out[path] = []
    return out


def read_file(path: Path, name: str, meta: LogMeta) -> list[RawTrial]:
    """The trials of one CSV or NPZ file: one, or one for each value of its `trial` column."""
    header, rename, rate = column_names(path), meta.columns, meta.rows_per_second
    place_names = _places(path, header, rename)
    given_names = _lists(path, header, rename) | {theirs: new for new, theirs in rename.items()}
    name_of = {
        column: given_names.get(column, column)
        for column in header
        if column in given_names or column not in rename
    }
    wanted = [
        column
        for column, ours in name_of.items()
        if (role(ours) is not None or ours in COUNTERS) and not is_ignored(ours, meta.ignore)
    ]
    labels = next((column for column in wanted if name_of[column] in TRIAL), None)
    has_time = any(name_of[column] in TIME for column in wanted)
    if path.suffix.lower() == ".npz" and not has_time and rate is None:
        raise _no_time(path, header)
    data_columns = {column: name_of[column] for column in wanted if column != labels}
    if not data_columns and len(header) == 1 and len(header[0].split()) > 1:
        data_columns = {"time": "time", "q1": "q1"}  # so that it is told what the header is
    table = _read(
        path,
        data_columns | {_list_name(place): _list_name(place) for place in place_names},
        place_names,
    )
    table = replace(table, ignored=tuple(c for c in table.ignored if c != labels))
    if rate is not None and not has_time:
        columns = {"time": np.arange(len(table.lines)) / rate, **table.columns}
        note = f"no time: rows taken {rate:g} times a second, as declared"
        table = replace(table, columns=columns, notes=(*table.notes, note))
    time = next((column for column in table.columns if column in TIME), None)
    if time is None:
        raise _no_time(path, header)
    if labels:
        parts = _labelled(path, labels, table)
    else:
        parts = _restarted(path, name, table, table.columns[time])
    for _, part in parts:
        clock = part.columns[time]
        if not np.all(np.diff(clock) > 0):
            mend = _mend(path, header, rename.get(time, time), rename, part, clock)
            check_clock(path, clock, part.lines, part.row_word, mend)
    return [
        RawTrial(
            label, str(path), t.columns, t.lines, t.row_word, t.ignored, t.notes, units=t.units
        )
        for label, t in parts
    ]


def _places(path: Path, header: list[str], rename: Mapping[str, str]) -> dict[str, str]:
    """What `[columns]` says of single places of lists (`q[2]` -> ours). BadInput where it names a
    column that is not there.
    """
    places = {}
    for ours, theirs in rename.items():
        if theirs in header:
            continue
        if _list_name(theirs) not in header:
            raise BadInput(
                f"{path}: has no column {theirs!r}, which [columns] gives to {ours}; "
                f"{suggest(theirs, header)}"
            )
        places[theirs] = ours
    return places


def _restarted(
    path: Path, name: str, table: LogTable, time: np.ndarray
) -> list[tuple[str, LogTable]]:
    """The table, cut where its clock or its header starts again."""
    parts = cut_at_headers(table.lines, table.again) or cut_at_restarts(time)
    if not parts:
        return [(name, table)]
    label_column = trial_column(cells_of(path, table.lines), time)
    last_name = f"{name}_{len(parts)}"
    restarting = "header" if table.again else "clock"
    note = (
        f"the {restarting} of {path.name} starts again: taken as {len(parts)} trials, {name}_1 to "
        f"{last_name}"
    )
    if label_column:
        hint = f'; [columns] trial = "{label_column}" in meta.toml calls them by that column'
    else:
        hint = ""
    table = replace(table, notes=(*table.notes, note + hint))
    return [(f"{name}_{k}", _with_rows(table, part)) for k, part in enumerate(parts, 1)]


def _mend(
    path: Path,
    header: list[str],
    theirs: str,
    rename: Mapping[str, str],
    table: LogTable,
    time: np.ndarray,
) -> str:
    """What meta.toml may say of a clock that does not increase. Nothing where that is not known.

    Args:
        theirs: Its column.
    """
    time_parts = find_time_parts(header)
    if time_parts and theirs in time_parts and NANOS not in rename:
        return f"it has two parts, write {time_parts_line(*time_parts)} in meta.toml"
    if label := trial_column(cells_of(path, table.lines), time):
        return (
            f'column {label} seems to name trials, write [columns] trial = "{label}" in meta.toml'
        )
    return ""


def list_columns(path: Path) -> list[str]:
    """Columns of a CSV whose cells hold lists; arrays `[T, n]` of numbers in an archive."""
    if path.suffix.lower() == ".npz":
        return [
            name
            for name, array in read_archive(path).arrays.items()
            if array.ndim == 2 and array.dtype.kind in "fiu"
        ]
    first: dict[str, str] = {}
    rows = csv_rows(path, 40).rows  # topics of their own may begin some rows later
    for row in rows[1:]:
        for name, cell in zip(rows[0], row, strict=False):
            if cell.strip():
                first.setdefault(name, cell)
    return [name for name, cell in first.items() if is_list(cell)]


def _lists(path: Path, header: list[str], rename: Mapping[str, str]) -> dict[str, str]:
    """Columns of a CSV that hold lists of all joints by their usual names: theirs -> our stem."""
    if path.suffix.lower() == ".npz":
        lists = []
    else:
        lists = [name for name in list_columns(path) if role(name) is None]
    stem_of = {name: STEMS[name.lower()] for name in lists if name.lower() in STEMS}
    taken_names = set(rename) | {name for name in header if name not in lists}
    return {name: stem for name, stem in stem_of.items() if stem not in taken_names}


def _no_time(path: Path, header: list[str]) -> BadInput:
    if time_parts := find_time_parts(header):
        return BadInput(
            f"{path}: column 'time' is missing; it seems to have two parts, write "
            f"{time_parts_line(*time_parts)} in meta.toml"
        )
    if header:
        listed = f" (there are {', '.join(header[:8])}{', ...' if len(header) > 8 else ''})"
    else:
        listed = ""
    return BadInput(
        f"{path}: column 'time' is missing{listed}; add it (s), or name it by [columns] time = "
        f'"..." in meta.toml, or write rows_per_second = 100.0 there'
    )


def column_names(path: Path) -> list[str]:
    """The names of a file's columns (CSV) or arrays (NPZ)."""
    if path.suffix.lower() == ".npz":
        return list(read_archive(path).arrays)
    rows = csv_rows(path, 1).rows
    if not rows:
        read_table(path, TIME)  # says why: empty, unreadable, not text
        raise BadInput(f"{path}: is empty; remove it or record the trial again")
    return rows[0]


def _list_name(name: str) -> str:
    """The list or array of a place of one (`q[2]`); another name as it is."""
    part = stem_and_place(name)
    return part[0] if part else name


def _read(path: Path, named: Mapping[str, str], places: Mapping[str, str]) -> LogTable:
    """`read_table` of the columns in `named` (theirs -> ours); of lists and arrays `[T, n]` by
    place: `q` gives q1 to qn, or those `places` (`q[2]` -> ours) alone that are named.
    """
    lists = {_list_name(place) for place in places}
    table = read_table(path, tuple(named), ours=_Named(named), is_strict=False)
    rows = np.array([np.zeros(len(table.lines)), *table.columns.values()])
    if np.isinf(rows).any() or np.isnan(rows).any(0).mean() > TABLE.max_missing_share:
        check_missing(path, table.columns, table.lines, table.row_word, _Named(named))
    if missing_places := [place for place in places if place not in table.columns]:
        raise BadInput(
            f"{path}: has no place {missing_places[0]!r}, which [columns] gives to "
            f"{places[missing_places[0]]}; "
            "count from 0"
        )
    named = {**named, **places}
    columns = {n: x for n, x in table.columns.items() if n in places or _list_name(n) not in lists}
    orders: dict[str, list[str]] = {}
    for name in columns:
        part = None if name in named else stem_and_place(name)
        if part is None:
            continue
        orders.setdefault(part[0], []).append(name)
        column_role = role(named[part[0]])
        if column_role is not None and column_role.joint is not None:
            parts = sum((stem_and_place(c) or ("",))[0] == part[0] for c in table.columns)
            raise BadInput(
                f"{path}: column {part[0]!r} is one joint's and has shape ({len(table.lines)}, "
                f"{parts}); save one number for each row, or call it {column_role.stem} for a "
                "number of each joint"
            )
    units = {_ours(name, named): unit for name, unit in table.units.items() if name in named}
    notes = tuple(
        f"{name} holds a number for each joint, without names: taken in the model's order; "
        f'[columns] {named[name]} = ["{name}[1]", "{name}[0]"] is another'
        for name, place_columns in orders.items()
        if len(place_columns) > 1
    )
    columns = {_ours(name, named): values for name, values in columns.items()}
    return replace(table, columns=columns, units=units, notes=(*table.notes, *notes))


def _ours(name: str, named: Mapping[str, str]) -> str:
    """Our name of a column, or of a place of one that holds lists: `positions[0]` is q1 where
    positions are q.
    """
    part = None if name in named else stem_and_place(name)
    if part:
        return f"{named[part[0]]}{part[1] + 1}"
    return named[name]


class _Named(dict):
    """theirs -> ours, of places of lists too."""

    def get(self, name, default=None):
        part = None if name in self else stem_and_place(name)
        if name in self or (part and part[0] in self):
            return _ours(name, self)
        return default


def csv_rows(path: Path, most: int | None = None) -> CsvRows:
    """See `csv_rows.rows_of`; what is no text is found when the table is read."""
    return rows_of(path, read_lines(path)[0].decode("utf-8-sig", errors="replace"), most)


def _labelled(path: Path, column: str, table: LogTable) -> list[tuple[str, LogTable]]:
    """The table cut by its column of trial names, in the order in which they appear."""
    labels = cells_of(path, table.lines)[column]
    parts = []
    array = np.array(labels)
    for label in dict.fromkeys(labels):
        rows = np.flatnonzero(array == label)
        if not label:
            raise BadInput(
                f"{path}: {table.row_word} {table.lines[rows[0]]}: column {column} is empty; name "
                "the trial"
            )
        parts.append((_trial_label(label), _with_rows(table, rows)))
    return parts


def _with_rows(table: LogTable, rows: np.ndarray | slice) -> LogTable:
    columns = {name: values[rows] for name, values in table.columns.items()}
    return replace(table, columns=columns, lines=table.lines[rows])


def cells_of(path: Path, lines: np.ndarray | None = None) -> dict[str, list[str]]:
    """What each column holds in these lines (None: in all), as written; of an archive arrays that
    are columns, in these rows.
    """
    if path.suffix.lower() == ".npz":
        arrays = {name: x for name, x in read_archive(path).arrays.items() if x.ndim == 1}
        if lines is not None:
            arrays = {name: x[lines[lines <= len(x)] - 1] for name, x in arrays.items()}
        return {name: [str(value) for value in x] for name, x in arrays.items()}
    csv = csv_rows(path)
    cells_at = dict(zip(csv.lines, csv.rows, strict=True))
    header = {name: place for place, name in reversed(list(enumerate(csv.rows[0])))}

    def cell(row, place):
        if place < len(row):
            return row[place].strip().strip('"')
        return ""

    line_numbers = csv.lines[1:] if lines is None else [int(line) for line in lines]
    return {
        name: [cell(cells_at.get(line, []), place) for line in line_numbers]
        for name, place in header.items()
    }


def _trial_label(label: str) -> str:
    """`3.0` is trial 3."""
    if re.fullmatch(r"\d+\.0", label):
        return label.removesuffix(".0")
    return label
