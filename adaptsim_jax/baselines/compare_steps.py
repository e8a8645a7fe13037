"""The comparison of policies over many steps: every method in every target, by what it would
deploy after so many target trials.

A method that tries policies deploys the one whose own trials, smoothed over all means that it
tried, returned most; SysID and fine-tuning the newest; UDR what it has. What is deployed is scored
by episodes that chose nothing, and normalised: 0 what UDR earns in that target, 1 the oracle or the
best in Omega, whichever is more.
"""

import importlib.util
import sys
from collections.abc import Callable, Hashable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from adaptsim_jax.adaptation.phase2 import smoothed
from adaptsim_jax.adaptation.training import learned
from adaptsim_jax.baselines.arena import MethodRun, Visits
from adaptsim_jax.baselines.config import CompareConfig
from adaptsim_jax.baselines.registry import STEPS, steps_methods
from adaptsim_jax.baselines.results import (
    ComparisonParts,
    bootstrap_interval,
    plain,
    quartiles,
    row,
)
from adaptsim_jax.baselines.steps_arena import StepsArena
from adaptsim_jax.core import config as configs
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.environments.setting import EnvironmentConfig, Setting
from adaptsim_jax.environments.task import environment_setting, task_of

BUDGETS = (0, 2, 5, 10, 20, 40)
TRIED = ("adaptsim", "bayesopt", "cma_es", "gradient")
"""Methods that deploy the best of what they tried, by its own trials."""
BOUNDS = ("best_in_omega", "oracle")
ROOM = 0.02
"""Of the upper bound: where UDR is nearer to it than this, a target separates methods by luck
alone.
"""


class Deployed(NamedTuple):
    """Of one seed: what is deployed after so many target `trials [n]`, and its mean `returns
    [T, n]` in each target.
    """

    trials: np.ndarray
    returns: np.ndarray

    def at(self, budget: int) -> np.ndarray:
        """Returns `[T]` of what is deployed after at most `budget` trials. Not a number where the
        method deploys nothing so early.
        """
        there = np.flatnonzero(self.trials <= budget)
        if len(there):
            return self.returns[:, there[-1]]
        return np.full(len(self.returns), np.nan)


class StepsComparison:
    """A policy is trained for each seed; the methods of a seed share it, and all seeds what is
    compiled.
    """

    task_name, always, begins = "environment", ("udr", "oracle"), "policies"

    def __init__(self, setting: Setting, names: list[str], config: CompareConfig):
        if setting.config.policy == "planned":
            raise BadInput(
                "compare: methods are compared by trained policies; set train.task.policy to "
                "'knows' or 'tuned'"
            )
        self.setting, self.names, self.config = setting, names, config
        self.same = replace(config, seeds=1, seed=0)  # seeds are parts of their own
        self.methods, self.task = steps_methods(), task_of(setting)
        seeds = range(config.seed, config.seed + config.seeds)
        self.groups = [(f"seed-{seed}-", np.array([seed])) for seed in seeds]
        self.programs: dict[Hashable, Any] = {}
        self.arenas: dict[int, tuple[StepsArena, Table]] = {}

    def digest(self) -> str:
        return self.task.preparation.digest()  # type: ignore[union-attr]

    def lack(self, method: str) -> str:
        configs.pick("method", method, self.methods)
        package = {"cma_es": "cma", "sbi": "sbi"}.get(method)
        if package and importlib.util.find_spec(package) is None:
            return f"needs the package {package} (pip install {package})"
        if method in ("sbi", "gradient") and self.setting.config.policy != "knows":
            return 'is for policy = "knows"'
        if method == "cma_es" and self.setting.space.dim == 1:
            return "needs two fields or more"
        return ""

    def prepare(self, parts: ComparisonParts) -> None:
        """Nothing: UDR and the oracle are methods, run for every seed."""

    def record(self, method: str, seeds: np.ndarray, report: Callable) -> Deployed:
        """What the method deploys, for one seed."""
        seed = int(seeds[0])
        if seed not in self.arenas:
            prepared = learned(self.task, self.task.preparation, seed, None, report)  # type: ignore[arg-type]
            self.arenas = {seed: (self.arena(prepared, seed), {})}  # of one seed at a time
        arena, shared = self.arenas[seed]
        return deployed_by(method, MethodRun(self.config, arena, seeds, report, shared))

    def arena(self, prepared: Any, seed: int) -> StepsArena:
        """Where the methods of a seed meet the targets, with the policy of that seed."""
        tests = self.config.steps.tests
        return StepsArena(self.setting, prepared, self.names, tests, seed, self.programs)

    def rows(self, method: str, found: Table) -> list[Table]:
        return rows_of(method, deployed_runs(found), self.names)

    def about(self, found: Table) -> Table:
        lower, upper = bounds_of(deployed_runs(found))
        ends = [*zip(self.names, lower, upper, strict=True)]
        if flat := [n for n, a, b in ends if b - a < 1.5 * ROOM * abs(b) + 1e-6]:
            print(
                f"compare: UDR is as good as the oracle in {', '.join(flat)}: nothing can be "
                "separated there",
                file=sys.stderr,
            )
        sim, targets = self.setting.sim, self.setting.targets
        fields = [f.name for f in self.setting.fields]

        def setting(name, low, high):
            values = map(float, targets[name].values)
            params = dict(zip(fields, values, strict=True))
            return {"params": params, "udr_return": float(low), "best_return": float(high)}

        return {
            "simulator": sim.name if sim.native is None else f"{sim.name} in MJX",
            "target_backend": ", ".join(dict.fromkeys(targets[n].engine for n in self.names)),
            "trials_axis": True,
            "reward": "return of what is deployed: 0 UDR, 1 the oracle or the best in Omega",
            "oracle": "the policy that knows E, trained on in the target",
            "settings": {name: setting(name, low, high) for name, low, high in ends},
        }


def setting_from(options: Table) -> Setting:
    """Of the options of an environment's task."""
    table = configs.from_table(EnvironmentConfig, dict(options), "compare, [train.task]")
    return environment_setting(table)


def deployed_runs(found: Table) -> dict[str, list[Deployed]]:
    """Parts as arrays; None is not a number."""

    def one(part):
        trials, returns = part
        return Deployed(np.array(trials), np.array(returns, float))

    return {method: [one(part) for part in parts] for method, parts in found.items()}


def deployed_by(method: str, run: MethodRun) -> Deployed:
    """What `method` deploys, for the one seed of `run`."""
    run.arena.own, run.arena.scored = [], []
    return deployed_of(method, STEPS[method](run), run.arena)


def deployed_of(method: str, visits: Visits, arena: StepsArena) -> Deployed:
    """What a method would deploy after each number of trials, and its return."""
    assert visits.rewards is not None  # methods of steps score their visits themselves
    rewards = visits.rewards[:, 0]  # [T, N, I]
    T = len(rewards)
    trials = arena.one.trials
    if method in TRIED:
        own = np.stack([s.reshape(T, -1) for s in arena.own], -1)  # [T, N, I]

        def order(x):
            return np.moveaxis(x, 1, 2).reshape(
                T, -1
            )  # as they were made: all starts of a visit, then the next

        own_returns, tests = order(np.where(np.isfinite(own), own, -np.inf)), order(rewards)
        best = np.array(
            [[np.argmax(x) for x in _expected(own_returns[t], visits, t, arena)] for t in range(T)]
        )
        spent = trials * np.arange(1, own_returns.shape[1] + 1)
        return Deployed(spent, np.take_along_axis(tests, best, 1))
    if method.startswith("sysid"):
        return Deployed(trials * np.arange(rewards.shape[2]), rewards[:, 0])
    return Deployed(np.asarray(visits.spent), rewards[:, 0])


def _expected(
    own_returns: np.ndarray, visits: Visits, t: int, arena: StepsArena
) -> Iterator[np.ndarray]:
    """Of the returns `own_returns [n]` in target t those that are expected after each visit: all so
    far, smoothed by `phase2.smoothed`.
    """
    if visits.means is None:
        yield from (own_returns[: n + 1] for n in range(len(own_returns)))
        return
    means = jnp.asarray(
        np.moveaxis(visits.means[t, 0], 0, 1).reshape(len(own_returns), -1), jnp.float32
    )
    for n in range(len(own_returns)):
        unknown = jnp.where(
            jnp.arange(len(own_returns)) <= n, jnp.asarray(own_returns), -jnp.inf
        )  # one program for all
        yield np.asarray(smoothed(means, unknown, arena.setting.config.doubt))[: n + 1]


def bounds_of(found: dict[str, list[Deployed]]) -> tuple[np.ndarray, np.ndarray]:
    """`lower [T]`, what UDR earns, and `upper [T]`, means over seeds; apart by at least a small
    share of the upper.
    """

    def last(method):
        return np.mean([d.returns[:, -1] for d in found[method]], 0)

    lower = last("udr")
    upper = np.max([last(m) for m in BOUNDS if found.get(m)], 0)
    return lower, np.maximum(upper, lower + ROOM * np.abs(upper) + 1e-6)


def rows_of(method: str, found: dict[str, list[Deployed]], names: list[str]) -> list[Table]:
    """A row for each target: normalised returns of what is deployed at last, the curve over trials,
    and at each budget.
    """
    lower, upper = bounds_of(found)
    runs, out = found[method], []
    spent = None if method in BOUNDS else int(runs[0].trials[-1])
    for t, name in enumerate(names):

        def norm(x, t=t):
            return (np.asarray(x) - lower[t]) / (upper[t] - lower[t])

        curves = norm([d.returns[t] for d in runs])
        line = row(method, name, curves[:, -1:], oracle=1.0, target_trials=spent)
        line["curve"] = quartiles(curves)
        line["trials"] = runs[0].trials
        line["returns"] = [float(d.returns[t, -1]) for d in runs]
        line["at"] = {str(b): _interval(norm([d.at(b)[t] for d in runs])) for b in BUDGETS}
        out.append(plain(line))
    return out


def _interval(values: np.ndarray) -> Table | None:
    if not np.isfinite(values).all():
        return None
    low, high = bootstrap_interval(values)
    return {"mean": float(values.mean()), "low": low, "high": high, "per_seed": values}
