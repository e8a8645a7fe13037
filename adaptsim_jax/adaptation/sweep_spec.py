"""What a sweep is to do: members, each a configuration and a seed; and on which line of its SPEC.toml
a key stands, so that every fault is named with its line.
"""  # noqa: E501

import re
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

from adaptsim_jax.adaptation.training import TrainConfig
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import BadInput

MOST = 1_000_000  # members


Entries = list[Any]  # a field of the spec is called `list`, and hides the type below it


@dataclass(frozen=True)
class Draws:
    """`[random]`: count: How many draws. seed: Of them. values: For each key a table, `{low,
    high}`, with `scale = "log"` or `integer = true` where wanted, or `{choice = [...]}`.
    """

    count: int = 0
    seed: int = 0
    values: Table = field(default_factory=dict)


@dataclass(frozen=True)
class Range:
    """What a value is drawn from: between `low` and `high` evenly (or on a logarithmic scale), or
    one of `choice`.
    """

    low: float | None = None
    high: float | None = None
    scale: Literal["linear", "log"] = "linear"
    integer: bool = False
    choice: list[Any] = field(default_factory=list)


@dataclass(frozen=True)
class SweepSpec:
    """SPEC.toml as it stands.

    task, or an env.toml from this file's folder; preset or config (a file of `adaptsim train`):
    where members start from, else the task's default. set: Changed in all.
    Members are grid x random x list x seeds. grid: Key = [values]. list: Tables of keys that belong
    together. seeds: How many (0, 1, ...) or which. targets: Settings of the task to adapt to (none:
    Phase 1 alone), from `starts` members of S_E for `iterations` steps. keep: Leave each member's
    run folder, for `adaptsim adapt`.
    """

    task: str
    preset: str | None = None
    config: str | None = None
    targets: list[str] = field(default_factory=list)
    seeds: int | list[int] = 1
    starts: int = 2
    iterations: int = 10
    keep: bool = False
    set: Table = field(default_factory=dict)
    grid: Table = field(default_factory=dict)
    random: Draws = field(default_factory=Draws)
    list: Entries = field(default_factory=Entries)


class Member(NamedTuple):
    """One run of the sweep: values: What it differs by, by dotted key. config: All that it is run
    with, its seed too.
    """

    index: int
    values: Table
    config: TrainConfig


class Sweep(NamedTuple):
    """A spec, read and checked, with its members in order. swept: The keys that members differ
    by.
    """

    spec: SweepSpec
    members: tuple[Member, ...]
    swept: tuple[str, ...]


_HEADER = re.compile(r"\s*(\[\[?)\s*([^\[\]=]+?)\s*\]\]?\s*(#.*)?$")


_KEY = re.compile(r"""\s*((?:"[^"]*"|'[^']*'|[\w-]+)(?:\s*\.\s*(?:"[^"]*"|'[^']*'|[\w-]+))*)\s*=""")


class Lines:
    """Lines, counted from 1, of the keys of a TOML text by their dotted names. Entries of
    `[[name]]` are `name.0`, `name.1`, ...
    """

    def __init__(self, path: str, text: str):
        self.path, self.at = path, dict(_keys(text))

    def where(self, key: str) -> str:
        """'FILE, line 7' for a dotted key, or for the table it would stand in; 'FILE' where neither
        is in the text.
        """
        while key not in self.at and "." in key:
            key = key.rpartition(".")[0]
        if key in self.at:
            return f"{self.path}, line {self.at[key]}"
        return self.path

    @contextmanager
    def blamed(self, key: str) -> Iterator[None]:
        """Bad input that is raised inside is said to stand on the line of `key`."""
        try:
            yield
        except BadInput as error:
            where = self.where(key)
            raise BadInput(
                str(error) if str(error).startswith(where) else f"{where}: {error}"
            ) from None


def _keys(text: str) -> Iterator[tuple[str, int]]:
    table, counts, before = "", {}, ""
    for number, line in enumerate(text.splitlines(), 1):
        if before:  # within an array of several lines
            before += "\n" + line
        elif found := _HEADER.match(line):
            table = _dotted(found[2])
            if found[1] == "[[":
                counts[table] = counts.get(table, -1) + 1
                table = f"{table}.{counts[table]}"
            yield table, number
            continue
        elif found := _KEY.match(line):
            name = _dotted(found[1])
            yield (f"{table}.{name}" if table else name), number
            before = line
        if before and _whole(before):
            before = ""


def _whole(text: str) -> bool:
    try:
        tomllib.loads(text)
    except ValueError:
        return False
    return True


def _dotted(name: str) -> str:
    parts = re.findall(r"""\"([^"]*)\"|'([^']*)'|([\w-]+)""", name)
    return ".".join("".join(part) for part in parts)
