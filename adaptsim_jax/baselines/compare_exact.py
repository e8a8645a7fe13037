"""The comparison on tasks whose policy is solved exactly, normalised as the paper's Table 1.

Costs are recomputed in double precision from the means of E that a method visited, by one code for
all methods.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.baselines.arena import MethodRun, Visits
from adaptsim_jax.baselines.bounds import (
    Best,
    ExactProblem,
    best_in_omega,
    costs,
    discrepancy,
    udr,
)
from adaptsim_jax.baselines.config import CompareConfig
from adaptsim_jax.baselines.registry import EXACT, PROBLEMS, exact_methods
from adaptsim_jax.baselines.results import (
    ComparisonParts,
    TogetherComparison,
    best_and_last,
    normalised,
    physical,
    row,
    task_digest,
)
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.base import Task

EXACTLY = "exact propagation of the linearized model (JAX)"


class Bounds(NamedTuple):
    """Costs `[T]` in the targets: of UDR (0), of the best in Omega (1), and of the target's own
    optimal policy.
    """

    best: Best
    lower: np.ndarray
    upper: np.ndarray
    own: np.ndarray

    @property
    def oracle(self) -> np.ndarray:
        """Rewards `[T]` of the targets' own policies."""
        return np.maximum(normalised(self.own, self.lower, self.upper), 1.0)


class ExactArena(NamedTuple):
    """What an exact method is given: the task by name with its options, what is solved, and the
    targets `[T, D]` (physical).
    """

    task_name: str
    task_options: Table
    problem: ExactProblem
    targets: np.ndarray


class ExactComparison(TogetherComparison):
    """A method says which means of E it visited."""

    begins, not_for = "bounds", "is not for"
    bounds: Bounds

    def __init__(self, task_name: str, task: Task, names: list[str], config: CompareConfig):
        if config.target or config.target_options:
            raise BadInput(
                f"compare: targets of task '{task_name}' are always its own model; leave target out"
            )
        super().__init__(task_name, names, config, exact_methods())
        self.digest = partial(task_digest, task)
        targets = np.array([task.space.values(task.settings[name], name) for name in names])
        problem = PROBLEMS[task_name](task.space)
        self.arena = ExactArena(task_name, config.train.task, problem, targets)

    def prepare(self, parts: ComparisonParts) -> None:
        """The normalisers, computed anew: a second or so once compiled."""
        self.bounds = find_bounds(self.arena.problem, self.arena.targets)

    def record(self, method: str, seeds: np.ndarray, report: Callable) -> list[Table]:
        """The method's rows, one for each target."""
        if method not in EXACT:
            return bound_rows(method, self.names, self.bounds, len(seeds))
        visits = EXACT[method](MethodRun(self.config, self.arena, seeds, report))
        return visiting_rows(method, self.names, self.arena, self.bounds, visits)

    def about(self, found: Table) -> Table:
        def setting(i: int) -> Table:
            return {
                "params": [float(p) for p in self.arena.targets[i]],
                "udr_cost": float(self.bounds.lower[i]),
                "best_cost": float(self.bounds.upper[i]),
                "best_unit_mean": [float(u) for u in self.bounds.best.mean[i]],
                "own_optimal_cost": float(self.bounds.own[i]),
            }

        return {
            "simulator": EXACTLY,
            "target_backend": EXACTLY.replace(")", ", double precision)"),
            "settings": {name: setting(i) for i, name in enumerate(self.names)},
        }


def find_bounds(problem: ExactProblem, targets: np.ndarray) -> Bounds:
    """The normalisers of `targets [T, D]` (physical)."""
    best = best_in_omega(problem, targets)
    policy = udr(problem)
    with jax.enable_x64(True):
        lower = np.array([float(problem.cost(t, policy.policy)) for t in targets])
        own = np.array(
            [float(problem.cost(t, problem.policy(t))) for t in jnp.asarray(targets, jnp.float64)]
        )
    if not np.all(lower > best.cost):
        raise BadInput(
            "compare: UDR is no worse than the best policy of Omega in a target, so rewards "
            "cannot be normalised; widen Omega"
        )
    return Bounds(best, lower, best.cost, own)


def visiting_rows(
    method: str, names: list[str], arena: ExactArena, bounds: Bounds, visits: Visits
) -> list[Table]:
    """A row for each target from the means that a method visited, with the dynamics discrepancy at
    each seed's best.
    """
    problem, means = arena.problem, np.asarray(visits.means)
    cost = costs(problem, means, arena.targets)
    curves = normalised(best_over(cost), bounds.lower, bounds.upper)
    out = []
    for i, name in enumerate(names):
        best, final = best_and_last(-cost[i], means[i])
        ratio = best_over(cost[i]).min(axis=1) / bounds.upper[i]
        gap = discrepancy(problem, best[None], arena.targets[i : i + 1])[0]
        extras = {
            "discrepancy": {"mean": gap.mean(), "median": np.median(gap), "per_seed": gap},
            "best_params": physical(problem.space, best),
            "final_params": physical(problem.space, final),
            "cost_ratio": {"best_mean": ratio.mean()},
            "failed": int(np.sum(~np.isfinite(cost[i]))),
        }
        ends = {"oracle": bounds.oracle[i], "target_trials": visits.target_trials}
        out.append(row(method, name, curves[i], **ends, **extras))
    return out


def best_over(costs: np.ndarray) -> np.ndarray:
    """Cost of the best of the N distributions at each iteration, `[..., N, I + 1] -> [..., I + 1]`;
    NaN never wins.
    """
    return np.min(np.where(np.isfinite(costs), costs, np.inf), axis=-2)


def bound_rows(method: str, names: list[str], bounds: Bounds, seeds: int) -> list[Table]:
    """The normalisers as rows: 0 and 1 by definition. UDR uses no target data; the best in Omega,
    the target's model.
    """
    value, trials = (0.0, 0) if method == "udr" else (1.0, None)
    curves = np.full((seeds, 1), value)
    return [
        row(method, name, curves, oracle=bounds.oracle[i], target_trials=trials)
        for i, name in enumerate(names)
    ]
