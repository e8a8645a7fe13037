"""`adaptsim compare`: methods x settings x seeds for any task; the schema of results.json.

One harness serves all tasks. What differs between them is a `Comparison`: which rows there are, how
a method meets its targets, and what its visits are worth (`compare_exact.py`, `compare_learned.py`,
`compare_steps.py`). All seeds, targets and starts of a group advance together.
"""

import sys
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any

from adaptsim_jax.baselines.compare_exact import ExactComparison
from adaptsim_jax.baselines.compare_learned import LearnedComparison
from adaptsim_jax.baselines.compare_steps import StepsComparison, setting_from
from adaptsim_jax.baselines.config import CompareConfig
from adaptsim_jax.baselines.registry import PROBLEMS
from adaptsim_jax.baselines.results import parts_of, plain
from adaptsim_jax.core import config as configs
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.progress import silent
from adaptsim_jax.tasks.registry import make_one_shot, make_task

SCHEMA = 1
STEPS_TASK = "environment"  # policies over many steps
Comparison = ExactComparison | LearnedComparison | StepsComparison


def compare(
    task: str,
    config: CompareConfig = CompareConfig(),  # noqa: B008
    progress: Callable = silent,
    command: str | None = None,
    out: str | Path | None = None,
) -> Table:
    """All of `config.methods` in all of `config.settings`: the table of results.json, whose rows
    are `results.row`'s.

    `progress(done, total, note)` is called as methods advance; `command` is what made the table,
    where a command line did. In the folder `out` what is done is kept as it goes, and taken from
    there where it was stopped before; `results.ComparisonParts.drop` removes it.
    """
    rows, about = compared(comparison_of(task, config), progress, out)
    return stamped(task, config, command) | about | {"rows": rows}


def comparison_of(task: str, config: CompareConfig) -> Comparison:
    """How methods are compared on `task`. BadInput names a setting or a target at fault."""
    made = make_task(task, config.train.task)
    chosen = [configs.pick("setting", s, made.settings) for s in config.settings]
    names = chosen or list(made.settings)
    if task == STEPS_TASK:
        return StepsComparison(setting_from(config.train.task), names, config)
    if task in PROBLEMS:
        return ExactComparison(task, made, names, config)
    return LearnedComparison(make_one_shot(task, config.train.task), names, config)


def compared(
    comparison: Comparison, progress: Callable = silent, out: str | Path | None = None
) -> tuple[list[Table], Table]:
    """Rows of all methods that are asked for, and what else results.json says of them. In `out`
    each method's part is kept.
    """
    methods = wanted(comparison)
    every = [*dict.fromkeys((*comparison.always, *methods))]
    parts = parts_of(out, comparison.task_name, comparison.same, comparison.digest)
    total = 1 + len(comparison.groups) * len(every)
    progress(0, total, comparison.begins)
    comparison.prepare(parts)
    found: dict[str, list[Any]] = {method: [] for method in every}
    for g, (word, seeds) in enumerate(comparison.groups):
        for i, method in enumerate(every):

            def report(done, of, note="", at=(g, i), name=f"{word}{method}"):
                first = 1 + at[0] * len(every) + at[1]
                progress(first + done / max(of, 1), total, f"{name} {note}".strip())

            def record(method=method, seeds=seeds, report=report):
                return plain(comparison.record(method, seeds, report))

            report(0, 1)
            found[method].append(parts.of(f"{word}{method}", record))
            report(1, 1)
    rows = [row for one in methods for row in comparison.rows(one, found)]
    return rows, comparison.about(found) | {"digest": parts.digest}


def wanted(comparison: Comparison) -> list[str]:
    """The rows that are asked for. Where none is, all that can be run here, and a line for each
    that cannot. BadInput names a method that the task has not.
    """
    asked = [method.replace("-", "_") for method in comparison.config.methods]
    out = []
    for method in asked or comparison.methods:
        lack = comparison.lack(method)
        if not lack:
            out.append(method)
        elif asked:
            if method in comparison.methods:
                hint = "; leave it out of --methods"
            else:
                hint = ""
            raise BadInput(f"compare: method '{method}' {lack}{hint}")
        else:
            print(f"compare: no row '{method}': it {lack}", file=sys.stderr)
    return out


def stamped(task: str, config: CompareConfig, command: str | None = None) -> Table:
    """What every results.json begins with."""
    versions = {
        name: metadata.version(name) for name in ("adaptsim_jax", "jax", "flax", "numpy", "scipy")
    }
    return {
        "schema": SCHEMA,
        "task": task,
        "seeds": config.seeds,
        "seed": config.seed,
        "command": command,
        "versions": versions | {"python": sys.version.split()[0]},
        "iterations": config.iterations,
        "starts": config.starts,
    }
