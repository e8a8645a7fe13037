"""How a diagnosis was run, which every report tells alike: by which command, with which version,
for how long.
"""

import shlex
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import adaptsim_jax
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.files import write_json
from adaptsim_jax.logs.pool import Data, paths_of

Page = Callable[[Path, Table, Table], None]
"""Writes a report into a folder, `(folder, report, evidence)`."""


class Run(NamedTuple):
    """The command that gives the same answer, when it began (`time.monotonic`), and its seed."""

    command: str
    began: float
    seed: int = 0

    def as_dict(self) -> Table:
        """`report["run"]`, at its end."""
        return {
            "version": adaptsim_jax.__version__,
            "seed": self.seed,
            "command": self.command,
            "seconds": round(time.monotonic() - self.began, 1),
        }


OPTIONS = (
    "seed",
    "model",
    "as_declared",
    "simulator",
    "yardstick",
    "horizon",
    "exclude",
    "without",
)
"""Options of `adaptsim diagnose`, as it is told how to give an answer again."""


def command_of(data: Data, out: str | Path | None = None, **given: Any) -> str:
    """The command that gives the same answer.

    Args:
        data: What was diagnosed.
        out: Folder of the results; another one where None.
        given: `OPTIONS` by name; what is None, false or empty is left to the command.
    """
    assert not set(given) - set(OPTIONS), given
    words = ["adaptsim", "diagnose", *map(str, paths_of(data)), "--out", str(out or "again")]
    for name in OPTIONS:
        value = given.get(name)
        if not value:
            continue
        words.append(f"--{name.replace('_', '-')}")
        if isinstance(value, (list, tuple)):
            words += map(str, value)
        elif value is not True:
            words.append(str(value))
    return shlex.join(words)


def plain(folder: Path, report: Table, evidence: Table) -> None:
    """`report.json` alone: the `Page` where none is given."""
    write_json(folder / "report.json", report)
