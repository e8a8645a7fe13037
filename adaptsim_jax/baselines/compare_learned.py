"""The comparison on tasks whose policies are learned: the methods tried in a world.

Rewards are as the task gives them (for the push, as in the paper's Table 1, 20 cm is the most that
counts): no normalising between UDR and the best of Omega. The oracle is what the best action for
each test context earns in the target itself.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from adaptsim_jax.baselines.arena import Arena, MethodRun, Visits
from adaptsim_jax.baselines.config import CompareConfig
from adaptsim_jax.baselines.registry import LEARNED, ORACLE, learned_methods
from adaptsim_jax.baselines.results import (
    ComparisonParts,
    TogetherComparison,
    best_and_last,
    bootstrap_interval,
    physical,
    row,
    task_digest,
)
from adaptsim_jax.core.config import Table
from adaptsim_jax.tasks.one_shot import OneShot


class LearnedComparison(TogetherComparison):
    """Methods meet their targets in an arena that counts its trials."""

    begins, not_for = "oracle", "needs a task that is solved exactly; for"
    oracle: np.ndarray

    def __init__(self, one: OneShot, names: list[str], config: CompareConfig):
        space, settings = one.task.space, one.task.settings
        super().__init__(one.task.name, names, config, learned_methods())
        self.one = one
        self.targets = np.array([space.values(settings[name], name) for name in names])
        self.world = one.world(config.target or one.engine, **config.target_options)
        self.shared: Table = {}

    def digest(self) -> str:
        return task_digest(self.one.task, self.one.scored)

    def prepare(self, parts: ComparisonParts) -> None:
        """What the best actions earn in each target."""

        def best():
            return [float(np.mean(self.one.oracle(self.world, t))) for t in self.targets]

        self.oracle = np.array(parts.of("oracle-rewards", best))

    def record(self, method: str, seeds: np.ndarray, report: Callable) -> list[Table]:
        """The method's rows, one for each target."""
        if method == ORACLE:
            curves = np.broadcast_to(self.oracle[:, None, None], (len(self.names), len(seeds), 1))
            return [
                row(method, n, c, oracle=o, target_trials=None)
                for n, c, o in zip(self.names, curves, self.oracle, strict=True)
            ]
        arena = Arena(self.one, self.world, self.targets)
        visits = run_method(method, MethodRun(self.config, arena, seeds, report, self.shared))
        return visits_rows(method, self.names, visits, self.oracle, arena)

    def about(self, found: Table) -> Table:
        return about(self.one, self.world.name, self.names, self.targets, self.oracle)


def run_method(method: str, run: MethodRun) -> Visits:
    """What `method` did, with what its policies earned in the fresh contexts."""
    visits, fresh = LEARNED[method](run), run.arena.fresh
    if fresh:
        return visits._replace(fresh=np.stack(fresh, -1).reshape(visits.rewards.shape))
    return visits


def visits_rows(
    method: str, names: list[str], visits: Visits, oracle: np.ndarray, counts: Any
) -> list[Table]:
    """A row for each target: at each iteration the best of the distributions that a method adapts
    at once.

    `oracle [T]`: rewards; `counts.failed`, `counts.made` `[T]`: trials; `counts.one`: the task.
    """
    out = []
    for i, name in enumerate(names):
        rewards: np.ndarray = visits.rewards[i]  # type: ignore[index]
        curves = rewards.max(axis=1)
        extras: Table = {
            "trials": visits.spent,
            "failed": int(counts.failed[i]),
            "made": int(counts.made[i]),
            "of_oracle": curves.max(axis=1).mean() / oracle[i] if oracle[i] else None,
        }
        if visits.means is not None:
            best, last = best_and_last(rewards, visits.means[i])
            space = counts.one.task.space
            extras |= {"best_params": physical(space, best), "final_params": physical(space, last)}
        if visits.fresh is not None:
            extras["fresh"] = on_fresh(rewards, visits.fresh[i])
        ends = {"oracle": oracle[i], "target_trials": visits.target_trials}
        out.append(row(method, name, curves, **ends, **extras))
    return out


def on_fresh(rewards: np.ndarray, fresh: np.ndarray) -> Table:
    """What policies earn in contexts that did not choose them, `rewards` and `fresh` `[S, N, I +
    1]`: of each seed's best by the tests its mean, 95 % interval and values, where several are best
    the mean of those; and the mean of the last iteration's.
    """
    S = len(rewards)
    flat, others = rewards.reshape(S, -1), fresh.reshape(S, -1)
    best = flat == flat.max(1, keepdims=True)
    chosen = (others * best).sum(1) / best.sum(1)
    low, high = bootstrap_interval(chosen)
    return {
        "mean": chosen.mean(),
        "low": low,
        "high": high,
        "per_seed": chosen,
        "final_mean": fresh[..., -1].mean(),
    }


def about(
    one: OneShot, world: str, names: list[str], targets: np.ndarray, oracle: np.ndarray
) -> Table:
    """What results.json says of the targets beside the rows."""
    return {
        "simulator": one.simulator,
        "target_backend": world,
        "reward": one.reward_unit,
        "oracle": one.oracle_means,
        "settings": {
            name: {"params": [float(p) for p in target], "oracle_reward": float(best)}
            for name, target, best in zip(names, targets, oracle, strict=True)
        },
    }
