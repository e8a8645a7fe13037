"""How a diagnosis was run, which every report tells alike: by which command, with which version,
for how long.
"""

import shlex
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import adaptsim_jax
from adaptsim_jax.core.files import write_json

Page = Callable[[Path, dict[str, Any], dict[str, Any]], None]
"""Writes a report into a folder, `(folder, report, evidence)`."""


class Run(NamedTuple):
    """The command that gives the same answer, when it began (`time.monotonic`), and its seed."""

    command: str
    began: float
    seed: int = 0

    def as_dict(self) -> dict[str, Any]:
        """`report["run"]`, at its end."""
        return {
            "version": adaptsim_jax.__version__,
            "seed": self.seed,
            "command": self.command,
            "seconds": round(time.monotonic() - self.began, 1),
        }


def command_of(
    data: str | Path,
    *,
    out: str | Path | None = None,
    seed: int = 0,
    model: str | Path | None = None,
    exclude: Sequence[str] = (),
    without: Sequence[str] = (),
    as_declared: bool = False,
    simulator: str | None = None,
    yardstick: str | None = None,
    horizon: float | None = None,
) -> str:
    """The command that gives the same answer; what is None is left to the command."""
    words = [
        "adaptsim",
        "diagnose",
        str(data),
        "--out",
        str(out or "again"),
        *(["--seed", str(seed)] if seed else []),
    ]
    words += ["--model", str(model)] if model is not None else []
    words += ["--as-declared"] if as_declared else []
    for option, value in (
        ("--simulator", simulator),
        ("--yardstick", yardstick),
        ("--horizon", horizon),
    ):
        words += [option, str(value)] if value is not None else []
    for option, names in (("--exclude", exclude), ("--without", without)):
        words += [option, *names] if names else []
    return shlex.join(words)


def plain(folder: Path, report: dict[str, Any], evidence: dict[str, Any]) -> None:
    """`report.json` alone: the `Page` where none is given."""
    write_json(folder / "report.json", report)
