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

import jax
import jax.numpy as jnp

from adaptsim_jax import __version__
from adaptsim_jax.baselines.config import CompareConfig
from adaptsim_jax.core import config as configs
from adaptsim_jax.core.files import output_folder, write_json
from adaptsim_jax.core.traced import digest_of, digest_of_arrays
from adaptsim_jax.space import gaussian
from adaptsim_jax.tasks.base import Task

FOLDER = "unfinished"


@dataclass(frozen=True)
class ComparisonParts:
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
        there = self.get(name)
        if there is None:
            return self.put(name, make())
        return there

    def drop(self) -> None:
        """Remove them: what they were kept for is written."""
        if self.folder is not None and self.folder.exists():
            for path in self.folder.glob("*.json"):
                path.unlink()
            with contextlib.suppress(OSError):  # not empty: parts of another configuration
                self.folder.rmdir()
                self.folder.parent.rmdir()


def parts_of(
    out: str | Path | None,
    task: str,
    config: CompareConfig,
    digest: Callable[[], str] | None = None,
) -> ComparisonParts:
    """Parts in `out`, those of this configuration alone (its `methods` may be others), and a line
    where some are there.

    `digest`: of what the task computes; asked for where parts are kept.
    """
    if out is None:
        return ComparisonParts()
    out = Path(out)
    about = {"version": __version__, "task": task, "traced": digest() if digest else ""}
    parts = ComparisonParts(
        out,
        configs.digest({"about": about, "config": configs.to_table(replace(config, methods=()))}),
    )
    if there := len(list(parts.folder.glob("*.json"))):  # type: ignore[union-attr]
        print(
            f"compare: {out / FOLDER} holds {there} part{'s' * (there > 1)} of the same "
            "comparison, which was stopped; going on from there (to begin anew, remove that "
            "folder)",
            file=sys.stderr,
        )
    return parts


def task_digest(task: Task, contexts: Any = None) -> str:
    """Of what a task computes in training, rolling out and scoring, and of its test contexts."""

    def run(key, mean, params):
        policy = task.train(key, gaussian(task.space, mean), task.init_policy(key))
        trajectory = task.rollout(key, policy, params)
        reward = task.reward(trajectory, task.reference(params))
        return task.observe(trajectory), task.score(trajectory), reward

    zeros = jnp.zeros(task.space.dim)
    return digest_of(run, jax.random.key(0), zeros, zeros) + digest_of_arrays(contexts)


@contextlib.contextmanager
def report_unfinished(out: Path) -> Iterator[None]:
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
