"""Lists and arrays of all joints in tables: cells of a CSV that hold lists, and NPZ archives."""

from __future__ import annotations

import io
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.columns import key_of, role
from adaptsim_jax.logs.criteria import TABLE
from adaptsim_jax.logs.csv_rows import read_bytes

LIST = re.compile(r"\s*[\[({](.*)[\])}]\s*", re.DOTALL)
STEMS = key_of("lists")
"""What lists of all joints are called -> our stem."""


def is_list(cell: str) -> bool:
    """Whether a cell holds a list."""
    return LIST.fullmatch(cell) is not None


def split(
    path: str | Path, name: str, cells: Sequence[str], lines: Sequence[int]
) -> dict[str, tuple[str, ...]]:
    """A column's cells `[T]` by the name of the column; of lists `[T]` for each place by `name[0]`,
    `name[1]`, ... BadInput at a list of another length.
    """
    first = next((cell for cell in cells if cell.strip()), "")
    if not is_list(first):
        return {name: tuple(cells)}
    width, out = len(_parts(first)), []
    for cell, line in zip(cells, lines, strict=True):
        parts = _parts(cell) if cell.strip() else [""] * width
        if len(parts) != width:
            raise BadInput(
                f"{path}: line {line}: column {name} holds a list of {len(parts)}, the first one "
                f"of {width}; mend or remove that row"
            )
        out.append(parts)
    return {part_name(name, k): tuple(column) for k, column in enumerate(zip(*out, strict=True))}


def _parts(cell: str) -> list[str]:
    match = LIST.fullmatch(cell)
    inner = (match[1] if match else cell).strip()
    return [part for part in re.split(r"\s*[,;]\s*|\s+", inner) if part]


def part_name(name: str, place: int) -> str:
    """How a place of a list is called until it has a joint."""
    return f"{name}[{place}]"


def stem_and_place(name: str) -> tuple[str, int] | None:
    """The column and the place that `part_name` made a name of; None for another name."""
    match = re.fullmatch(r"(.*)\[(\d+)\]", name)
    if match:
        return (match[1], int(match[2]))
    return None


MAX_LISTED = 6
"""Arrays whose shapes one line may list."""


@dataclass(frozen=True)
class Archive:
    """`arrays`: those that are wanted, None for the others; `transposed`: names of those that had a
    joint a row.
    """

    arrays: dict[str, Any]
    transposed: tuple[str, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """What was done to read it, a line each."""
        return (
            "arrays with a row for each joint turned to a row for each sample: "
            f"{', '.join(self.transposed)}",
        ) * bool(self.transposed)


def read_archive(path: Path, wanted: Collection[str] | None = None) -> Archive:
    """Arrays of an archive, those `wanted` (None: all); nothing in it is ever executed (no
    pickles). Raises `BadInput`.
    """
    raw = read_bytes(path)
    try:
        with np.load(io.BytesIO(raw), allow_pickle=False) as data:
            shapes = {name: _shape(data, name) for name in data.files}
            arrays = {
                name: data[name] if wanted is None or name in wanted else None
                for name in data.files
            }
    except (
        Exception
    ) as e:  # zip, zlib, struct, header parser, memory: damaged bytes raise any of them
        why = " ".join(str(e).split())[:80] or type(e).__name__
        raise BadInput(
            f"{path}: is no readable .npz of plain arrays ({why}); save it again with numpy.savez"
        ) from None
    lengths = {max(shape) for shape in shapes.values() if _is_column(shape)}
    transposed = tuple(
        name for name, x in arrays.items() if x is not None and _has_rows(x.shape, lengths)
    )
    out = dict(arrays)
    for name, x in arrays.items():
        if x is not None:
            out[name] = x.T if name in transposed else _as_column(name, x)
    return Archive(out, transposed)


def _shape(data: Any, name: str) -> tuple[int, ...]:
    """The shape of an array, which is not loaded for it."""
    if f"{name}.npy" not in data.zip.namelist():
        return data[name].shape
    with data.zip.open(f"{name}.npy") as file:
        version = np.lib.format.read_magic(file)
        if version == (1, 0):
            read_header = np.lib.format.read_array_header_1_0
        else:
            read_header = np.lib.format.read_array_header_2_0
        return read_header(file)[0]


def _is_column(shape: tuple[int, ...]) -> bool:
    return bool(shape) and sum(size != 1 for size in shape) == 1


def _has_rows(shape: tuple[int, ...], lengths: Collection[int]) -> bool:
    """Whether an array has the samples along its second axis, as columns of these lengths tell."""
    if len(shape) != 2 or 1 in shape or not shape[0] < shape[1]:
        return False
    return shape[1] in lengths and (shape[0] not in lengths or shape[0] < TABLE.min_rows)


def _as_column(name: str, array: np.ndarray) -> np.ndarray:
    """A column as `[T]`; of what is called as an array of all joints is, `[T, 1]`, so that its
    joint is the first.
    """
    if array.ndim < 2 or not _is_column(array.shape):
        return array
    column_role = role(name)
    has_all_joints = name.lower() in STEMS or (
        column_role is not None
        and column_role.joint is None
        and column_role.stem not in ("time", "trial")
    )
    if has_all_joints:
        return array.reshape(-1, 1)
    return array.ravel()


def check_lengths(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """BadInput where arrays `[T, ...]` have not one T."""
    if len({len(array) for array in arrays.values()}) < 2:
        return
    shown = list(arrays.items())[:MAX_LISTED]
    sizes = ", ".join(f"{name} {' x '.join(map(str, array.shape))}" for name, array in shown)
    if len(arrays) > MAX_LISTED:
        rest = f" and {len(arrays) - MAX_LISTED} more"
    else:
        rest = ""
    raise BadInput(
        f"{path}: arrays differ in length ({sizes}{rest}); save them with one row per sample"
    )
