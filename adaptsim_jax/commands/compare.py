"""`adaptsim compare`."""

from __future__ import annotations

import argparse
import shlex
import sys
from typing import Any

from adaptsim_jax.core.config import Table

EXAMPLES = """
  adaptsim compare pendulum --out results
  adaptsim compare pendulum --out quick --seeds 2 --settings wd,ood-1 --methods adaptsim,sysid-point
  adaptsim compare pendulum --out small --seeds 3 --set train.phase1.trajectories=2000
  adaptsim compare pushing --out push --seeds 2 --settings wd,ood-2 --methods sysid-bayes,learn-in-target,oracle
  adaptsim compare examples/env.toml --out env --seeds 3     an environment's policies, by return against target trials
  adaptsim compare pushing --out drake --seeds 1 --settings ood-1 --methods udr-target,oracle --target drake
A comparison that was stopped, or that failed, goes on with the same command: what was done is kept in DIR/unfinished.
"""  # noqa: E501


def run(args: argparse.Namespace) -> int:
    """Table 1 of the paper for one task."""
    from adaptsim_jax.commands.parser import output, print_file, task_word

    words, args.task = args.task, task_word(args)
    from adaptsim_jax.baselines.compare import compare
    from adaptsim_jax.baselines.results import ComparisonParts, report_unfinished
    from adaptsim_jax.core.progress import progress
    from adaptsim_jax.report.comparison import table, write_comparison

    asked = config_of(args)
    with output(args.out) as out, report_unfinished(out), progress(f"compare {words}") as report:
        results = compare(args.task, asked, report, shlex.join(["adaptsim", *sys.argv[1:]]), out)
        paths = [*write_comparison(results, out), *found_figure(results, asked.train.task, out)]
        ComparisonParts(out, results["digest"]).drop()
    if args.json:
        print_file(out / "results.json")
        return 0
    print(table(results))
    for path in paths:
        print(f"written: {path}")
    print(f"next: open {out / 'report.html'}")
    return 0


def found_figure(results: Table, options: Table, out: Any) -> list[Any]:
    """`parameters_found.png` in `out`, where methods adapted the parameters of a task whose
    policies are learned.
    """
    if "simulator" not in results or not any(row.get("best_params") for row in results["rows"]):
        return []
    from pathlib import Path

    from adaptsim_jax.report import figures as look
    from adaptsim_jax.report.figures_comparison import axes_of, parameters_found
    from adaptsim_jax.tasks.registry import TASKS, make_task

    task = results["task"]
    axes = axes_of(make_task(task, options).space, TASKS[task].symbols)
    figure = parameters_found(results, axes)
    return [look.save(figure, Path(out) / "parameters_found.png")]


def config_of(args: argparse.Namespace) -> Any:
    """The comparison's config from a file or the defaults, with what the command line changes; all
    of it checked.
    """
    from adaptsim_jax.adaptation.phase1 import make_phase1
    from adaptsim_jax.baselines.config import CompareConfig, default_comparison
    from adaptsim_jax.baselines.registry import (
        PROBLEMS,
        exact_methods,
        learned_methods,
        steps_methods,
    )
    from adaptsim_jax.core import config
    from adaptsim_jax.tasks.registry import make_task

    where = args.config or "--set"
    defaults = config.to_table(default_comparison(args.task))
    defaults = config.over(defaults, {"train": args.env})
    start = config.from_table(
        CompareConfig, config.over(defaults, config.read(args.config) if args.config else {}), where
    )
    given = {
        "seeds": args.seeds,
        "seed": args.seed if args.seed_given else None,
        "target": args.target,
    }
    settings = [f"{name}={value}" for name, value in given.items() if value is not None]
    if args.methods is not None:
        methods = [word.strip().replace("-", "_") for word in args.methods.split(",")]
        for method in methods:
            if args.task in PROBLEMS:
                known = exact_methods()
            else:
                known = learned_methods()
            config.pick("method", method, steps_methods() if args.task == "environment" else known)
        settings.append(f"methods={methods}")
    if args.settings is not None:
        settings.append(f"settings={[word.strip() for word in args.settings.split(',')]}")
    asked = config.with_settings(start, [*args.set, *settings])
    task = make_task(args.task, asked.train.task, where)
    for setting in asked.settings:
        config.pick("setting", setting, task.settings)
    make_phase1(task, asked.train.phase1)
    return asked
