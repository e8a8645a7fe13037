"""What every reader checks of a table of named columns: cells that are missing, and a time that is
one clock in seconds.

Each function takes what a file holds and how its rows are called; `BadInput` names the file, the
row and a mend that works.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.columns import TIME, role
from adaptsim_jax.logs.criteria import TABLE

OPTIONAL = ("v", "tau_commanded", "target")
"""Stems of columns that a reader can do without: where they hold nothing they count as not there.
"""
SMALLER = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}


def without_blank(
    path: str | Path, columns: Mapping[str, np.ndarray], min_rows: int, ours: Mapping[str, str]
) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """`columns [T]` (NaN where a cell is missing) without optional ones that hold nothing, and a
    note on these.

    BadInput where a column that is needed holds nothing.

    Args:
        ours: What a column is to us where the file names it otherwise.
    """
    blank = [
        name
        for name, values in columns.items()
        if len(values) >= min_rows and np.isnan(values).all()
    ]
    for name in blank:
        if not _is_optional(ours.get(name, name)):
            raise BadInput(
                f"{path}: column {name} holds no number in any row; record it, or take the column "
                "out"
            )
    not_blank = {name: values for name, values in columns.items() if name not in blank}
    if blank:
        notes = (f"{', '.join(blank)} held no number in {Path(path).name}: taken as not recorded",)
    else:
        notes = ()
    return not_blank, notes


def _is_optional(name: str) -> bool:
    column_role = role(name)
    return column_role is not None and column_role.stem in OPTIONAL


def check_missing(
    path: str | Path,
    columns: Mapping[str, np.ndarray],
    lines: np.ndarray,
    row_word: str,
    ours: Mapping[str, str] | None = None,
) -> None:
    """BadInput at the first cell that is no finite number.

    Args:
        ours: What a column is to us where the file names it otherwise.
    """
    is_missing = {name: ~np.isfinite(values) for name, values in columns.items()}
    is_missing = {name: rows for name, rows in is_missing.items() if rows.any()}
    if not is_missing:
        return
    _check_joined(path, columns, len(lines), ours or {})
    name, rows = min(is_missing.items(), key=lambda item: int(np.argmax(item[1])))
    at = np.flatnonzero(rows)
    value = columns[name][at[0]]
    description = "holds no number" if np.isnan(value) else f"is {value}"
    rest = f" (and {at.size - 1} more)" if at.size > 1 else ""
    raise BadInput(
        f"{path}: {row_word} {lines[at[0]]}: column {name} {description}{rest}; fill or remove "
        "such rows"
    )


def _check_joined(
    path: str | Path, columns: Mapping[str, np.ndarray], count: int, ours: Mapping[str, str]
) -> None:
    """BadInput where rows hold parts of a sample in turn, as an outer join of topics on their times
    leaves them.
    """
    clock = next((name for name in columns if ours.get(name, name) in TIME), "time")
    names = [name for name in columns if name != clock]
    is_there = np.stack([np.isfinite(columns[name]) for name in names], 1)
    is_incomplete = ~is_there.all(1)
    if count < 2 or is_incomplete.mean() < TABLE.min_incomplete_share:
        return
    kinds = Counter(map(tuple, is_there[is_incomplete].tolist()))
    frequent_kinds = [
        kind
        for kind, rows in kinds.most_common(4)
        if rows > TABLE.min_kind_share * count and any(kind)
    ]
    if not frequent_kinds or not all(
        is_there[:, j].mean() > TABLE.min_column_share for j in range(len(names))
    ):
        return
    parts = [
        [n for n, is_there_in in zip(names, kind, strict=True) if is_there_in]
        for kind in frequent_kinds
    ]
    text = "; ".join(
        f"{', '.join(part)} in {kinds[kind]} rows"
        for part, kind in zip(parts, frequent_kinds, strict=True)
    )
    first = parts[0]
    others = [n for n in names if n not in first] or names

    def quote(words):
        return ", ".join(repr(w) for w in words)

    raise BadInput(
        f"{path}: rows hold parts of a sample ({text}), as topics joined by time do; bring them "
        f"onto one clock, with pandas: pd.merge_asof(df[[{clock!r}, {quote(first)}]].dropna(), "
        f"df[[{clock!r}, {quote(others)}]].dropna(), on={clock!r}).dropna().to_csv(...)"
    )


def check_size(
    path: str | Path,
    name: str,
    values: np.ndarray,
    lines: np.ndarray,
    row_word: str,
    limit: float = TABLE.max_value,
) -> np.ndarray:
    """`values [T]` in SI units. BadInput at the first of them that is beyond `limit`."""
    too_large = np.flatnonzero(np.abs(values) > limit)
    if too_large.size:
        where = f"{path}: {row_word} {lines[too_large[0]]}"
        why = f"column {name} is {values[too_large[0]]:.4g} in SI units, beyond {limit:g}"
        raise BadInput(f"{where}: {why}; mend that row, or declare [units] in meta.toml")
    return values


def from_zero(time: np.ndarray) -> np.ndarray:
    """Times `[T]` s as they are, clock times from the first of them."""
    if abs(time[0]) > TABLE.min_clock_time:
        return time - time[0]
    return time


def check_clock(
    path: str | Path, time: np.ndarray, lines: np.ndarray, row_word: str, mend: str = ""
) -> None:
    """BadInput at the first row at which `time [T]` does not increase, with what clocks and files
    do to cause it.

    Args:
        mend: What to do, where more is known than that rows are out of order.
    """
    not_increasing = np.flatnonzero(np.diff(time) <= 0)
    if not not_increasing.size:
        return
    other = mend or 'call the one that does time, in a log by [columns] time = "..." in meta.toml'
    hint = "" if np.ptp(time) else other
    if lost := lost_digits(time):
        raise BadInput(f"{path}: {lost}{', or, as it never changes, ' if hint else ''}{hint}")
    if hint:
        raise BadInput(f"{path}: time never changes; {hint}")
    i = int(not_increasing[0]) + 1
    where = f"{path}: {row_word} {lines[i]}"
    find_time_parts = f"{time[i - 1]:.9g} then {time[i]:.9g}"
    if time[i] == time[i - 1]:
        raise BadInput(
            f"{where}: time repeats ({find_time_parts}); {mend or 'sort or remove such rows'}"
        )
    usual_mend = "sort or remove such rows, or cut the file there if the clock was set"
    raise BadInput(f"{where}: time runs backwards ({find_time_parts}); {mend or usual_mend}")


def lost_digits(time: np.ndarray) -> str:
    """What to say of times `[T]` that float32 cannot hold; nothing where it can."""
    step = single_precision(time)
    if not step:
        return ""
    return (
        f"time has lost its digits: it was kept in float32, whose steps are {step:g} here; save it "
        "as float64, or take the first time off before saving"
    )


def single_precision(time: np.ndarray) -> float:
    """The step of float32 at these times where all are of that precision and many rows repeat; else
    0.
    """
    size = float(np.max(np.abs(time), initial=0.0))
    if not TABLE.max_float32_time < size < 1e30:
        return 0.0
    step = float(np.spacing(np.float32(size)))
    exact = np.array_equal(time, np.asarray(time, np.float32).astype(float))
    if exact and np.mean(np.diff(time) == 0) > TABLE.min_repeated_share:
        return step
    return 0.0


def check_time_unit(path: str | Path, time: np.ndarray, scale: float, mend: str = "") -> None:
    """BadInput where `time [T]`, which `scale` made seconds, is of another unit: rows are too far
    apart, or too near.

    Args:
        mend: What to do; a line of [units] in meta.toml by default.
    """
    if len(time) < 2:
        return
    step = float(np.median(np.diff(time)))
    if step > TABLE.max_interval:
        unit = next((u for u, size in SMALLER.items() if step * size <= TABLE.max_interval), None)
        if unit is None:
            raise BadInput(f"{path}: a row every {step:.3g} s; record at 50 Hz or more")
        word = {"ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}[unit]
        how = mend or f'write time = "{unit}" under [units] in meta.toml, or convert the file'
        raise BadInput(f"{path}: a row every {step:.3g} s: time is suspected in {word}; {how}")
    if step < TABLE.min_interval and scale != 1.0:
        raise BadInput(
            f"{path}: a row every {step:.3g} s by the declared unit of time; write the unit that "
            "the file has under [units] in meta.toml"
        )
