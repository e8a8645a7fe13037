"""The rows of a CSV file: its delimiter, remarks above its header, units below it, and widths of
rows.
"""

from __future__ import annotations

import csv
import io
import itertools
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.log_units import unit_of


def read_bytes(path: Path) -> bytes:
    """All of a file; BadInput where it cannot be read."""
    try:
        return path.read_bytes()
    except OSError as e:
        raise BadInput(
            f"{path}: cannot be read ({e.strerror}); check the path and its permissions"
        ) from None


ZEROS = b"\x00" * 4
"""What a power cut leaves of lines that were not yet on the disk; UTF-16 text has no four in a row.
"""


def read_lines(path: Path) -> tuple[bytes, tuple[int, ...]]:
    """All of a file, but for lines that hold `ZEROS`, and which these are."""
    raw = read_bytes(path)
    if ZEROS not in raw:
        return raw, ()
    lines = raw.split(b"\n")
    cut = tuple(k for k, line in enumerate(lines, 1) if ZEROS in line)
    return b"\n".join(b"" if ZEROS in line else line for line in lines), cut


DELIMITERS = {",": "commas", ";": "semicolons", "\t": "tabs"}
REMARKS = ("#", "%", "//")
"""What opens a line above the header that names no columns."""


@dataclass(frozen=True)
class CsvRows:
    """Rows of a CSV that hold anything, the header's first, and their lines. Cells as they are but
    for the header's.

    - `units`: Column -> what a row of units below the header says.
    - `again`: Lines on which the header stands again, as a logger that was started anew writes it.
    """

    rows: list[list[str]]
    lines: list[int]
    units: dict[str, str]
    again: tuple[int, ...]


def rows_of(path: Path, text: str, most: int | None = None) -> CsvRows:
    """The first `most` rows (None: all) of a CSV."""
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    above, text, delimiter = _from_header(text)
    reader = csv.reader(io.StringIO(text), delimiter=delimiter)
    rows, lines, units, again = [], [], {}, []
    try:
        for row in reader:
            if not any(cell.strip() for cell in row):
                continue
            line = above + reader.line_num
            if rows and _header(row) == rows[0]:
                again.append(line)
            elif len(rows) == 1 and not units and _are_units(row):
                units = dict(zip(rows[0], map(_without_brackets, row), strict=False))
            else:
                rows.append(_within(row, len(rows[0])) if rows else _header(row))
                lines.append(line)
            if len(rows) == most:
                break
    except csv.Error as e:
        raise BadInput(
            f"{path}: line {above + reader.line_num}: not CSV ({e}); mend or remove that line"
        ) from None
    return CsvRows(rows, lines, units, tuple(again))


def _without_brackets(cell: str) -> str:
    return cell.strip(" []()")


def _are_units(row: list[str]) -> bool:
    """Whether a row names units, of most columns at least."""
    cells = [cell for cell in map(_without_brackets, row) if cell]
    n_units = sum(unit_of(cell) is not None for cell in cells)
    return 2 * n_units > len(cells) and not any(map(is_number, cells))


def _within(row: list[str], n: int) -> list[str]:
    """A row without what separators at its end open behind the header's `n` columns."""
    if any(cell.strip() for cell in row[n:]):
        return row
    return row[:n]


def _header(row: list[str]) -> list[str]:
    first, *others = (cell.strip().strip('"') for cell in row)
    return [first.lstrip("# ").strip(), *others]


def _from_header(text: str) -> tuple[int, str, str]:
    """How many lines stand above the header, the text from it on, and what parts its cells.

    The header is the first line that is no remark. Where that one holds numbers, the last remark of
    as many names.
    """
    remarks, at, above, first = [], 0, 0, ""
    for line in io.StringIO(text):
        if line.strip(" \n" + "".join(DELIMITERS)) and not line.lstrip().startswith(REMARKS):
            first = line
            break
        at, above = at + len(line), above + 1
        remarks.append(line)
    names = next((k for k in reversed(range(len(remarks))) if _names(remarks[k], first)), None)
    if names is None:
        return above, text[at:], _delimiter(first)
    below = "\n" * (len(remarks) - names - 1)  # lines keep their numbers
    return names, remarks[names].rstrip("\n") + "\n" + below + text[at:], _delimiter(remarks[names])


def _names(remark: str, first: str) -> bool:
    """Whether a remark names the columns: of `first`, the first row of numbers, or, where nothing
    follows (""), of none.
    """
    names, delimiter = _cells(remark), _delimiter(remark)
    if not first:
        return bool(names)
    row = _cells(first, delimiter)
    return (
        len(names) == len(row) > 1 and any(map(is_number, row)) and not any(map(is_number, names))
    )


def _delimiter(line: str) -> str:
    return max(DELIMITERS, key=line.count)


def _cells(line: str, delimiter: str | None = None) -> list[str]:
    """The cells of one line, but for empty ones at its end."""
    delimiter = delimiter or _delimiter(line)
    return next(csv.reader([line.strip().rstrip(delimiter)], delimiter=delimiter), [])


def is_number(cell: str) -> bool:
    """Whether a cell holds a number, or nan."""
    try:
        float(cell)
    except ValueError:
        return False
    return True


def check_header(
    path: Path, header: list[str], line: int, wanted: tuple[str, ...], more: bool
) -> None:
    """BadInput where a header names no columns, or one of those `wanted` twice.

    Args:
        more: Whether the rows below it have more cells.
    """
    if all(is_number(cell) for cell in header):
        names = [name for name in wanted if not is_number(name)] or ["time", "q1", "tau1"]
        raise BadInput(
            f"{path}: line {line} holds numbers, not column names; add a header line such as "
            f"{','.join(names)}"
        )
    for name in header:
        if name in wanted and header.count(name) > 1:
            raise BadInput(
                f"{path}: column {name!r} appears {header.count(name)} times; keep one of them"
            )
    if len(header) == 1 and len(wanted) > 1:
        if more:
            mend = "remove the lines above the columns' names"
        else:
            mend = "separate columns by commas"
        raise BadInput(f"{path}: line {line} is one column {header[0][:60]!r}; {mend}")


def check_widths(path: Path, rows: Sequence[list[str]], lines: Sequence[int]) -> None:
    """BadInput at the first of `rows`, the header before them, that has not as many cells as the
    header.
    """
    n = len(rows[0])
    at = next((k for k, row in enumerate(rows) if len(row) != n), None)
    if at is None:
        return
    row = rows[at]
    usual, often = Counter(len(r) for r in rows[1:]).most_common(1)[0]
    if len(row) in (2 * n, 2 * n - 1) and all(is_number(c) for c in row if c.strip()):
        why = "decimal commas suspected: write decimals with a point"
    elif len(row) > n and any(_in_thousands(a, b) for a, b in itertools.pairwise(row)):
        why = "commas between thousands suspected: write 1234.5, nothing between the digits"
    elif usual > n and often > len(rows) / 2 and any(row[n:]):
        above = "remove what stands above the columns' names, or begin it with #"
        why = f"as {often} lines have: {above}"
    else:
        why = "complete or remove that line"
    raise BadInput(
        f"{path}: line {lines[at]}: has {len(row)} values, the header has {n} columns; {why}"
    )


def _in_thousands(before: str, cell: str) -> bool:
    """Whether two neighbouring cells look like a number that was cut at the comma of its
    thousands.
    """
    return bool(
        re.fullmatch(r"[-+]?[1-9]\d{0,2}", before.strip())
        and re.fullmatch(r"\d{3}(\.\d*)?", cell.strip())
    )
