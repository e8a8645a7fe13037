"""`adaptsim compare`: methods x settings x seeds, normalised as the paper's Table 1; the schema of
results.json.
"""

import sys
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.baselines.adaptsim_row import best_over
from adaptsim_jax.baselines.best_in_omega import Best, best_in_omega
from adaptsim_jax.baselines.compare_learned import compare_learned
from adaptsim_jax.baselines.compare_steps import compare_steps
from adaptsim_jax.baselines.config import CompareConfig
from adaptsim_jax.baselines.methods import Run, Visits
from adaptsim_jax.baselines.parts import parts_of
from adaptsim_jax.baselines.problem import Problem, costs, discrepancy
from adaptsim_jax.baselines.registry import EXACT, PROBLEMS, exact_methods
from adaptsim_jax.baselines.summary import normalised, physical, row
from adaptsim_jax.baselines.udr import Udr, udr
from adaptsim_jax.core import config as configs
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.progress import silent
from adaptsim_jax.tasks.registry import make_one_shot, make_task

SCHEMA = 1
STEPS_TASK = "environment"  # policies over many steps


class Bounds(NamedTuple):
    """Costs `[T]` in the targets: of UDR (0), of the best in Omega (1), and of the target's own
    optimal policy.
    """

    udr: Udr
    best: Best
    lower: np.ndarray
    upper: np.ndarray
    own: np.ndarray


def compare(
    task: str,
    config: CompareConfig = CompareConfig(),  # noqa: B008
    progress: Callable = silent,
    command: str | None = None,
    out: str | Path | None = None,
) -> dict[str, Any]:
    """All of `config.methods` in all of `config.settings`: the table of results.json, whose rows
    are `summary.row`'s.

    `progress(done, total, note)` is called as methods advance; `command` is what made the table,
    where a command line did. Costs are recomputed in double precision from the means of E that a
    method visited, by one code for all methods. In the folder `out` what is done is kept as it
    goes, and taken from there where it was stopped before; `parts.Parts.drop` removes it.
    """
    made = make_task(task, config.train.task)
    names = [configs.pick("setting", s, made.settings) for s in config.settings] or list(
        made.settings
    )
    if task == STEPS_TASK:
        rows, about = compare_steps(config.train.task, names, config, progress, out)
        return stamped(task, config, command) | about | {"rows": rows}
    if task not in PROBLEMS:
        one = make_one_shot(task, config.train.task)
        rows, about = compare_learned(one, names, config, progress, out)
        return stamped(task, config, command) | about | {"rows": rows}
    methods = _exact_methods(task, config)
    targets = np.array([made.space.values(made.settings[name], name) for name in names])
    problem = PROBLEMS[task](made.space)
    progress(0, len(methods) + 1, "bounds")
    bounds = find_bounds(problem, targets)
    seeds = np.arange(config.seed, config.seed + config.seeds)
    rows, total, parts = [], len(methods) + 1, parts_of(out, task, config)
    for i, method in enumerate(methods):

        def report(done, of, note="", i=i, method=method):
            progress(1 + i + done / max(of, 1), total, f"{method} {note}".strip())

        report(0, 1)
        if method in EXACT:
            run = Run(task, config.train.task, config, problem, targets, seeds, report)

            def visited(m=method, r=run):
                return visiting_rows(m, names, problem, targets, bounds, EXACT[m](r))

            rows += parts.of(method, visited)
        else:
            rows += bound_rows(method, names, bounds, config.seeds)
        report(1, 1)
    about = _about(names, targets, bounds) | {"digest": parts.digest}
    return stamped(task, config, command) | about | {"rows": rows}


def _exact_methods(task: str, config: CompareConfig) -> list[str]:
    if config.target or config.target_options:
        raise BadInput(
            f"compare: targets of task '{task}' are always its own model; leave target out"
        )
    methods = [m.replace("-", "_") for m in config.methods] or list(exact_methods())
    for method in methods:
        if method not in exact_methods():
            raise BadInput(
                f"compare: method '{method}' is not for {task}; there is: "
                f"{', '.join(exact_methods())}"
            )
    return methods


def find_bounds(problem: Problem, targets: np.ndarray) -> Bounds:
    """The normalisers of `targets [T, D]` (physical), computed anew: a second or so once
    compiled.
    """
    best = best_in_omega(problem, targets)
    policy = udr(problem)
    with jax.enable_x64(True):
        lower = np.array([float(problem.cost(t, policy.policy)) for t in targets])
        own = np.array(
            [float(problem.cost(t, problem.policy(t))) for t in jnp.asarray(targets, jnp.float64)]
        )
    if not np.all(lower > best.cost):
        raise BadInput(
            "compare: UDR is no worse than the best policy of Omega in a target, so rewards cannot "
            "be normalised; widen Omega"
        )
    return Bounds(policy, best, lower, best.cost, own)


def visiting_rows(
    method: str,
    names: list[str],
    problem: Problem,
    targets: np.ndarray,
    bounds: Bounds,
    visits: Visits,
) -> list[dict[str, Any]]:
    """A row for each target from the means that a method visited, with the dynamics discrepancy at
    each seed's best.
    """
    cost = costs(problem, visits.means, targets)
    curves = normalised(best_over(cost), bounds.lower, bounds.upper)
    oracle = np.maximum(normalised(bounds.own, bounds.lower, bounds.upper), 1.0)
    out = []
    for i, name in enumerate(names):
        best, final = _best_means(visits.means[i], cost[i]), visits.means[i, :, :, -1]
        apart = discrepancy(problem, best[None], targets[i : i + 1])[0]
        extras = {
            "discrepancy": {"mean": apart.mean(), "median": np.median(apart), "per_seed": apart},
            "best_params": physical(problem.space, best),
            "final_params": physical(problem.space, final.reshape(-1, final.shape[-1])),
            "cost_ratio": {"best_mean": (best_over(cost[i]).min(axis=1) / bounds.upper[i]).mean()},
            "failed": int(np.sum(~np.isfinite(cost[i]))),
        }
        out.append(
            row(
                method,
                name,
                curves[i],
                oracle=oracle[i],
                target_trials=visits.target_trials,
                **extras,
            )
        )
    return out


def _best_means(means: np.ndarray, cost: np.ndarray) -> np.ndarray:
    """The mean `[S, D]` with the lowest cost that each seed visited, from `[S, N, I + 1, D]` and
    `[S, N, I + 1]`.
    """
    flat = np.where(np.isfinite(cost), cost, np.inf).reshape(len(cost), -1)
    return means.reshape(len(cost), -1, means.shape[-1])[np.arange(len(cost)), flat.argmin(axis=1)]


def bound_rows(method: str, names: list[str], bounds: Bounds, seeds: int) -> list[dict[str, Any]]:
    """The normalisers as rows: 0 and 1 by definition. UDR uses no target data; the best in Omega,
    the target's model.
    """
    value, trials = (0.0, 0) if method == "udr" else (1.0, None)
    oracle = np.maximum(normalised(bounds.own, bounds.lower, bounds.upper), 1.0)
    return [
        row(method, name, np.full((seeds, 1), value), oracle=oracle[i], target_trials=trials)
        for i, name in enumerate(names)
    ]


def _about(names: list[str], targets: np.ndarray, bounds: Bounds) -> dict[str, Any]:
    return {
        "simulator": "exact propagation of the linearized model (JAX)",
        "target_backend": "exact propagation of the linearized model (JAX, double precision)",
        "settings": {
            name: {
                "params": [float(p) for p in target],
                "udr_cost": float(bounds.lower[i]),
                "best_cost": float(bounds.upper[i]),
                "best_unit_mean": [float(u) for u in bounds.best.mean[i]],
                "own_optimal_cost": float(bounds.own[i]),
            }
            for i, (name, target) in enumerate(zip(names, targets, strict=True))
        },
    }


def stamped(task: str, config: CompareConfig, command: str | None = None) -> dict[str, Any]:
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
