"""Cells that hold lists, as `[0.1, 0.2]`: one number for each joint."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from adaptsim_jax.core.errors import BadInput

LIST = re.compile(r"\s*[\[({](.*)[\])}]\s*", re.DOTALL)
STEMS = {
    "positions": "q",
    "joint_positions": "q",
    "qpos": "q",
    "angles": "q",
    "joint_angles": "q",
    "velocities": "v",
    "joint_velocities": "v",
    "qvel": "v",
    "torques": "tau",
    "joint_torques": "tau",
    "efforts": "tau",
    "joint_efforts": "tau",
    "targets": "target",
    "commands": "target",
    "actions": "target",
    "joint_targets": "target",
}
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
    found = LIST.fullmatch(cell)
    inner = (found[1] if found else cell).strip()
    return [part for part in re.split(r"\s*[,;]\s*|\s+", inner) if part]


def part_name(name: str, place: int) -> str:
    """How a place of a list is called until it has a joint."""
    return f"{name}[{place}]"


def stem_and_place(name: str) -> tuple[str, int] | None:
    """The column and the place that `part_name` made a name of; None for another name."""
    found = re.fullmatch(r"(.*)\[(\d+)\]", name)
    if found:
        return (found[1], int(found[2]))
    return None
