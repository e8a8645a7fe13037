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
import numpy as np

from adaptsim_jax import __version__
from adaptsim_jax.baselines.config import CompareConfig
from adaptsim_jax.core import config as configs
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.files import output_folder, write_json
from adaptsim_jax.core.traced import digest_of, digest_of_arrays
from adaptsim_jax.space import Space, gaussian
from adaptsim_jax.tasks.base import Task

# ---------------------------------------------------------------- rows
#
# From costs in the targets to the rows of results.json: normalised as in the paper's Table 1, with
# intervals.

FAILED = 1e30  # stands for an infinitely bad reward, so that quantiles stay defined; shown as None


def normalised(costs: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Rewards `[T, ...]` from `costs [T, ...]`: 0 at UDR's cost `lower [T]`, 1 at the best in Omega
    `upper [T]`.

    Not clipped: a policy worse than UDR is below 0. A cost that is not finite is the worst reward,
    minus infinity.
    """
    shape = (-1,) + (1,) * (costs.ndim - 1)
    lower, upper = lower.reshape(shape), upper.reshape(shape)
    return np.where(np.isfinite(costs), (lower - costs) / (lower - upper), -np.inf)


def bootstrap_interval(
    values: np.ndarray, *, seed: int = 0, draws: int = 10_000
) -> tuple[float, float]:
    """95 % percentile-bootstrap interval of the mean of `values [S]`; one value has no interval, so
    both ends are it.
    """
    values = np.asarray(values, float)
    if len(values) < 2 or not np.all(np.isfinite(values)):
        return float(np.mean(values)), float(np.mean(values))
    picks = np.random.default_rng(seed).integers(0, len(values), (draws, len(values)))
    low, high = np.percentile(values[picks].mean(axis=1), [2.5, 97.5])
    return float(low), float(high)


def row(
    method: str,
    setting: str,
    curves: np.ndarray,
    *,
    oracle: float | None,
    target_trials: int | None,
    **extras: Any,
) -> Table:
    """One row from normalised rewards `curves [S, I + 1]` (the best of the N distributions at each
    iteration).

    mean, median, q25, q75, low, high and per_seed are of each seed's best iteration, as Table 1;
    `final_mean` is of the last iteration; `best_iteration_mean` is the largest over iterations of
    the mean over seeds.
    """
    curves = np.maximum(curves, -FAILED)
    best = curves.max(axis=1)
    low, high = bootstrap_interval(best)
    q25, median, q75 = np.percentile(best, [25, 50, 75])
    out = {
        "method": method,
        "setting": setting,
        "mean": best.mean(),
        "median": median,
        "q25": q25,
        "q75": q75,
        "final_mean": curves[:, -1].mean(),
        "low": low,
        "high": high,
        "oracle": oracle,
        "target_trials": target_trials,
        "per_seed": best,
        "best_iteration_mean": curves.mean(axis=0).max(),
        "mean_clipped": np.clip(best, 0.0, 1.0).mean(),
        "final_median": np.median(curves[:, -1]),
        "curve": quartiles(curves),
    }
    return plain({**out, **extras})


def quartiles(curves: np.ndarray) -> dict[str, np.ndarray]:
    """Median, quartiles and mean `[I + 1]` over seeds of `curves [S, I + 1]`."""
    return {
        "median": np.median(curves, axis=0),
        "q25": np.percentile(curves, 25, axis=0),
        "q75": np.percentile(curves, 75, axis=0),
        "mean": curves.mean(axis=0),
    }


def physical(space: Space, means: np.ndarray) -> np.ndarray:
    """Physical values of `means [..., D]`, in single precision."""
    return np.asarray(space.physical(jnp.asarray(means, jnp.float32)))


def best_and_last(rewards: np.ndarray, means: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pick means of E from a method's visits in one target.

    Args:
        rewards: `[S, N, I + 1]`; one that is not finite is never the best.
        means: `[S, N, I + 1, D]`.

    Returns:
        The mean `[S, D]` of each seed's best visit, and those `[S N, D]` of all last visits.
    """
    S, D = len(means), means.shape[-1]
    flat = np.where(np.isfinite(rewards), rewards, -np.inf).reshape(S, -1)
    best = means.reshape(S, -1, D)[np.arange(S), flat.argmax(1)]
    return best, means[:, :, -1].reshape(-1, D)


def plain(value: Any) -> Any:
    """The same as Python numbers, lists and dicts; what is not finite, or fails, becomes None."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, (float, np.floating)):
        if abs(value) < 1e-6 * FAILED:
            return float(value)
        return None
    if isinstance(value, np.integer):
        return int(value)
    return value


class TogetherComparison:
    """A comparison in which all seeds of a method run together and give its rows at once.

    Args:
        names: Of the settings. methods: Rows that there may be.
    """

    always: tuple[str, ...] = ()
    not_for: str
    """What keeps another method from the task that is named behind it."""

    def __init__(
        self, task_name: str, names: list[str], config: CompareConfig, methods: tuple[str, ...]
    ):
        self.task_name, self.names, self.config, self.same = task_name, names, config, config
        self.methods = methods
        self.groups = [("", np.arange(config.seed, config.seed + config.seeds))]

    def lack(self, method: str) -> str:
        """Say what keeps `method` from this task, nothing where it has it."""
        if method in self.methods:
            return ""
        return f"{self.not_for} {self.task_name}; there is: {', '.join(self.methods)}"

    def rows(self, method: str, found: Table) -> list[Table]:
        """The method's rows among what was found, one for each setting."""
        return found[method][0]


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
