"""One trial's file (`.csv` or `.npz`) read into named columns, every fault named by file and
line.
"""

import re
from codecs import BOM_UTF8
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.archive import MAX_LISTED, check_lengths, part_name, read_archive, split
from adaptsim_jax.logs.criteria import TABLE
from adaptsim_jax.logs.csv_rows import check_header, check_widths, is_number, read_lines, rows_of
from adaptsim_jax.logs.table_checks import check_missing, without_blank
from adaptsim_jax.logs.table_clocks import join_time, split_clock

NOTHING = ("", ".nan", "na", "n/a", "null", "none", "-")
"""What loggers write where they have no number, beside nan."""
DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")
DATE = re.compile(r"\d{4}-\d{2}-\d{2}[T ]\d|\d{1,2}[:.]\d{2}[:.]\d{2}")
THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2}([,' \u00a0\u2009\u202f]\d{3})+(\.\d*)?([eE][-+]?\d+)?")
"""A number with its thousands apart: `1,234.5`; without a point one comma alone may as well be a
decimal one.
"""
EMPTY = "is empty; remove it or record the trial again"


@dataclass(frozen=True)
class LogTable:
    """`columns`: name -> `[T]` float64 as written (no unit applied); `lines`: `[T]` line (or row)
    numbers.

    - `notes`: What was done to read it, a line each.
    - `units`, `again`: As of `CsvRows`.
    """

    columns: dict[str, np.ndarray]
    lines: np.ndarray
    ignored: tuple[str, ...]
    row_word: str = "line"
    notes: tuple[str, ...] = ()
    units: dict[str, str] = field(default_factory=dict)
    again: tuple[int, ...] = ()


def read_table(
    path: str | Path,
    wanted: tuple[str, ...],
    min_rows: int = TABLE.min_rows,
    ours: Mapping[str, str] | None = None,
    lost: tuple[str, ...] = (),
    gaps: tuple[str, ...] = (),
    is_strict: bool = True,
) -> LogTable:
    """Read the columns in `wanted` that are there, of `min_rows` rows or more; list the others.

    Raises `BadInput`.

    Args:
        ours: What a column is to us where the file names it otherwise; arrays [T, n] are then n
            columns by `archive.part_name`. Optional columns that hold nothing count as not
            there.
        lost: Columns of which a row may hold none, as cameras write frames in which they saw
            nothing: such rows are left out.
        gaps: Columns of which any cell may be empty, which is NaN then.
        is_strict: Whether other cells may not.
    """
    path = Path(path)
    if path.suffix.lower() == ".npz":
        table = _read_npz(path, wanted, lists=ours is not None)
    else:
        table = _read_csv(path, wanted)
    return _checked(path, _without_lost(table, lost), min_rows, ours or {}, gaps, is_strict)


def _without_lost(table: LogTable, lost: tuple[str, ...]) -> LogTable:
    """The table without the rows that hold a number in none of the columns `lost`."""
    has_number = [~np.isnan(table.columns[name]) for name in lost if name in table.columns]
    has_values = np.any(has_number, 0) if has_number else np.ones(len(table.lines), bool)
    if has_values.all() or not has_values.any():
        return table
    columns = {name: values[has_values] for name, values in table.columns.items()}
    return replace(table, columns=columns, lines=table.lines[has_values])


def _checked(
    path: Path,
    table: LogTable,
    min_rows: int,
    ours: Mapping[str, str],
    gaps: tuple[str, ...],
    is_strict: bool,
) -> LogTable:
    """The table without optional columns that hold nothing. BadInput for too few rows, and cells
    without a number but in `gaps`.
    """
    n = len(table.lines)
    if n < min_rows:
        raise BadInput(
            f"{path}: has {n} data rows; a trial needs at least {min_rows}, leave this file out"
        )
    columns, notes = without_blank(path, table.columns, min_rows, ours)
    columns, time_notes = join_time(path, columns, ours)
    lines, notes = table.lines, (*table.notes, *notes, *time_notes)
    if not gaps and (split := split_clock(path, columns, lines, ours)):
        columns, lines, time_notes = split
        notes = (*notes, *time_notes)
    filled = {
        name: np.where(np.isnan(values), 0.0, values)
        for name, values in columns.items()
        if name in gaps
    }
    if is_strict:
        check_missing(path, columns | filled, lines, table.row_word, ours)
    return replace(table, columns=columns, lines=lines, notes=notes)


def _decode(path: Path, raw: bytes) -> str:
    if not raw.removeprefix(BOM_UTF8).strip():
        raise BadInput(f"{path}: {EMPTY}")
    if b"\x00" in raw:
        raise BadInput(
            f"{path}: holds zero bytes (UTF-16 text or a binary file?); save it as plain UTF-8 CSV"
        )
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as e:
        line = raw[: e.start].count(b"\n") + 1
        raise BadInput(f"{path}: line {line}: not UTF-8 text; save it as plain UTF-8 CSV") from None


def _read_csv(path: Path, wanted: tuple[str, ...]) -> LogTable:
    """The table, NaN where a cell is empty."""
    raw, cut = read_lines(path)
    csv = rows_of(path, _decode(path, raw))
    rows, lines = csv.rows, csv.lines
    if not rows:
        raise BadInput(f"{path}: {EMPTY}")
    check_header(path, rows[0], lines[0], wanted, len(rows) > 1 and len(rows[1]) > 1)
    check_widths(path, rows, lines)
    header, rows, lines = rows[0], rows[1:], lines[1:]
    cells = list(zip(*rows, strict=True)) or [()] * len(header)
    columns = {
        part: _numbers(path, name, own_cells, lines)
        for name in wanted
        if name in header
        for part, own_cells in split(path, name, cells[header.index(name)], lines).items()
    }
    notes: tuple[str, ...] = ()
    if cut:
        cut_lines = ", ".join(map(str, cut[:MAX_LISTED]))
        notes = (f"{path.name} holds zero bytes (a power cut?), left out: line {cut_lines}",)
    others = _others(header, wanted)
    table = LogTable(columns, np.asarray(lines, dtype=np.int64), others, "line", notes)
    return replace(table, units=csv.units, again=csv.again)


def _others(names: list[str], wanted: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(name for name in names if name not in wanted)


def _numbers(path: Path, name: str, cells: tuple[str, ...], lines: list[int]) -> np.ndarray:
    """The cells of a column as numbers `[T]`, NaN where they are empty."""
    try:
        return np.array([float(cell) for cell in cells], dtype=np.float64)
    except ValueError:
        pass
    out = _seconds(cells)
    if out is not None:
        return out
    out = np.full(len(cells), np.nan)
    for row, cell in enumerate(cells):
        if is_number(cell):
            out[row] = float(cell)
        elif cell.strip().lower() not in NOTHING:
            raise BadInput(
                f"{path}: line {lines[row]}: column {name} is {cell.strip()[:40]!r}, "
                f"{_no_number(cell, cells)}"
            )
    return out


def _seconds(cells: tuple[str, ...]) -> np.ndarray | None:
    """Dates with times of ISO 8601 as s since 1970, in UTC where they have no zone; None where some
    are none.
    """
    try:
        moments = [datetime.fromisoformat(cell.strip()) for cell in cells]
    except ValueError:
        return None
    return np.array([m.replace(tzinfo=m.tzinfo or UTC).timestamp() for m in moments])


def _no_number(cell: str, cells: tuple[str, ...]) -> str:
    """What a cell is that is no number, and its mend, by what the column's other cells look
    like.
    """
    thousands, decimal = THOUSANDS.fullmatch(cell.strip()), DECIMAL_COMMA.fullmatch(cell.strip())
    if thousands and decimal:
        others = [c.strip() for c in cells if "," in c]
        if any("." in c for c in cells):
            decimal = None
        elif any(not THOUSANDS.fullmatch(c) for c in others):
            thousands = None
    if thousands and decimal:
        return (
            "thousands or decimals behind a comma; write thousands without one (1234.5), decimals "
            "with a point (1.2345)"
        )
    if decimal:
        return "a decimal comma; write decimals with a point"
    if thousands:
        return "with its thousands apart; write 1234.5, nothing between the digits"
    if DATE.match(cell.strip()):
        return (
            "a date that is not of ISO 8601; write seconds, with pandas: (pd.to_datetime(df[...], "
            "utc=True) - pd.Timestamp(0, tz='UTC')).dt.total_seconds()"
        )
    return "not a number; mend or remove that row"


def _read_npz(path: Path, wanted: tuple[str, ...], lists: bool) -> LogTable:
    """Arrays by column name, each `[T]`.

    Args:
        lists: Those `[T, n]` are columns by `part_name`.
    """
    archive = read_archive(path, wanted)
    arrays = {name: archive.arrays[name] for name in wanted if name in archive.arrays}
    for name, array in arrays.items():
        if array.ndim not in ((1, 2) if lists else (1,)) or array.dtype.kind not in "fiu":
            what = f"has shape {array.shape} and type {array.dtype}"
            raise BadInput(f"{path}: array {name!r} {what}; save it as numbers, one for each row")
    check_lengths(path, arrays)
    columns: dict[str, np.ndarray] = {}
    for name, array in arrays.items():
        if array.ndim == 1:
            parts = {name: array}
        else:
            parts = {part_name(name, k): x for k, x in enumerate(array.T)}
        columns |= {part: x.astype(np.float64) for part, x in parts.items()}
    n = max(map(len, arrays.values()), default=0)
    others = _others(list(archive.arrays), wanted)
    return LogTable(columns, np.arange(1, n + 1), others, row_word="row", notes=archive.notes)
