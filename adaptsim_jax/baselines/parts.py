"""Parts of a comparison, kept as they are done: one that is stopped, or that fails late, goes on
where it was.
"""

import contextlib
import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from adaptsim_jax import __version__
from adaptsim_jax.baselines.config import CompareConfig
from adaptsim_jax.core import config as configs
from adaptsim_jax.core.files import output_folder, write_json

FOLDER = "unfinished"


@dataclass(frozen=True)
class Parts:
    """Parts by name, of what has this `digest`, as JSON below `out`; where that is None nothing is
    kept.
    """

    out: Path | None = None
    digest: str = ""

    @property
    def folder(self) -> Path | None:
        if self.out is None:
            return None
        return self.out / FOLDER / self.digest[:16]

    def get(self, name: str) -> Any:
        """The part `name` as it was kept, None where it is not there."""
        if self.folder is not None:
            with contextlib.suppress(OSError, ValueError):
                return json.loads((self.folder / f"{name}.json").read_text())
        return None

    def put(self, name: str, value: Any) -> Any:
        """Keep `value`, plain data without NaN, as the part `name`; returns it."""
        if self.folder is not None:
            write_json(output_folder(self.folder) / f"{name}.json", value)
        return value

    def of(self, name: str, make: Callable[[], Any]) -> Any:
        """The part `name` as it was kept, or else what `make()` gives, which is kept."""
        kept = self.get(name)
        if kept is None:
            return self.put(name, make())
        return kept

    def drop(self) -> None:
        """Remove them: what they were kept for is written."""
        if self.folder is not None and self.folder.exists():
            for path in self.folder.glob("*.json"):
                path.unlink()
            with contextlib.suppress(OSError):  # not empty: parts of another configuration
                self.folder.rmdir()
                self.folder.parent.rmdir()


def parts_of(out: str | Path | None, task: str, config: CompareConfig, learned: str = "") -> Parts:
    """Parts in `out`, those of this configuration alone (its `methods` may be others), and a line
    where some are there.

    `learned`: digest of what the task learns once.
    """
    if out is None:
        return Parts()
    out = Path(out)
    about = {"version": __version__, "task": task, "learned": learned}
    parts = Parts(
        out,
        configs.digest({"about": about, "config": configs.to_table(replace(config, methods=()))}),
    )
    if there := len(list(parts.folder.glob("*.json"))):  # type: ignore[union-attr]
        print(
            f"compare: {out / FOLDER} holds {there} part{'s' * (there > 1)} of the same "
            f"comparison, which was stopped; "
            "going on from there (to begin anew, remove that folder)",
            file=sys.stderr,
        )
    return parts


@contextlib.contextmanager
def told_where_kept(out: Path) -> Iterator[None]:
    """Where the work within fails, a line on what of it is kept."""
    try:
        yield
    except BaseException:
        if (out / FOLDER).exists():
            print(
                f"compare: what was done is kept in {out / FOLDER}; the same command goes on there",
                file=sys.stderr,
            )
        raise
