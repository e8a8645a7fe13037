"""`adaptsim compare` for policies over many steps: every method in every target, by what it would
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
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from adaptsim_jax.adaptation.phase2 import smoothed
from adaptsim_jax.adaptation.prepared import learned
from adaptsim_jax.baselines.config import CompareConfig
from adaptsim_jax.baselines.learned import Bout, Trip
from adaptsim_jax.baselines.parts import parts_of
from adaptsim_jax.baselines.registry import STEPS, steps_methods
from adaptsim_jax.baselines.steps_arena import StepsArena
from adaptsim_jax.baselines.summary import bootstrap_interval, plain, row
from adaptsim_jax.core import config as configs
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.progress import silent
from adaptsim_jax.environments.config import EnvironmentConfig
from adaptsim_jax.environments.task import Setting, environment_setting, task_of

BUDGETS = (0, 2, 5, 10, 20, 40)
TRIED = (
    "adaptsim",
    "bayesopt",
    "cma_es",
    "gradient",
)  # deploy the best of what they tried, by its own trials
BOUNDS = ("best_in_omega", "oracle")
# of the upper bound: where UDR is nearer to it than this, a target tells methods apart by luck
# alone
ROOM = 0.02


def compare_steps(
    options: dict[str, Any],
    names: list[str],
    config: CompareConfig,
    progress: Callable = silent,
    out: str | Path | None = None,
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Rows of `config.methods` (all) in the targets `names`, and what else results.json says. A
    policy is trained for each seed. In `out` each seed's part of each method is kept.
    """
    setting = environment_setting(
        configs.from_table(EnvironmentConfig, dict(options), "compare, [train.task]")
    )
    if setting.config.policy == "planned":
        raise BadInput(
            "compare: methods are compared by trained policies; set train.task.policy to 'knows' "
            "or 'tuned'"
        )
    task = task_of(setting)
    made = task.preparation
    assert made is not None
    methods = _wanted(config, setting)
    every = [*dict.fromkeys(("udr", "oracle", *methods))]
    seeds = range(config.seed, config.seed + config.seeds)
    found: dict[str, list[Deployed]] = {method: [] for method in every}
    programs: dict[Hashable, Any] = {}
    parts = parts_of(out, task.name, replace(config, seeds=1, seed=0), made.digest())
    for i, seed in enumerate(seeds):

        def told(done, of, note="", i=i):
            return progress(i + done / max(of, 1), len(seeds), f"seed {i + 1}: {note}")

        there = {method: parts.get(f"seed-{seed}-{method}") for method in every}
        if left := [method for method in every if there[method] is None]:
            ready = learned(task, made, seed, None, told)
            for method, deployed in tried(
                setting, ready, names, left, config, seed, told, programs
            ):
                there[method] = parts.put(f"seed-{seed}-{method}", plain(list(deployed)))
        for method, (trials, returns) in there.items():
            found[method].append(
                Deployed((np.array(trials), np.array(returns, float)))
            )  # None is not a number
    return rows_of(found, methods, names), _about(setting, names, found) | {"digest": parts.digest}


def _wanted(config: CompareConfig, setting: Setting) -> list[str]:
    """The rows that are asked for; where none is, all that can be run here, and a line for each
    that cannot.
    """
    named = [configs.pick("method", m.replace("-", "_"), steps_methods()) for m in config.methods]
    out = []
    for method in named or steps_methods():
        if not (lack := _lack(method, setting)):
            out.append(method)
        elif named:
            raise BadInput(f"compare: method '{method}' {lack}; leave it out of --methods")
        else:
            print(f"compare: no row '{method}': it {lack}", file=sys.stderr)
    return out


def _lack(method: str, setting: Setting) -> str:
    package = {"cma_es": "cma", "sbi": "sbi"}.get(method)
    if package and importlib.util.find_spec(package) is None:
        return f"needs the package {package} (pip install {package})"
    if method in ("sbi", "gradient") and setting.config.policy != "knows":
        return 'is for policy = "knows"'
    if method == "cma_es" and setting.space.dim == 1:
        return "needs two fields or more"
    return ""


class Deployed(tuple):
    """`(trials [n], returns [T, n])` of one seed: what is deployed after so many target trials, and
    its mean return in each target.
    """

    @property
    def trials(self) -> np.ndarray:
        return self[0]

    @property
    def returns(self) -> np.ndarray:
        return self[1]

    def at(self, budget: int) -> np.ndarray:
        """Returns `[T]` of what is deployed after at most `budget` trials; not a number where the
        method deploys nothing so early.
        """
        there = np.flatnonzero(self.trials <= budget)
        if len(there):
            return self.returns[:, there[-1]]
        return np.full(len(self.returns), np.nan)


def tried(
    setting: Setting,
    ready: Any,
    names: list[str],
    methods: list[str],
    config: CompareConfig,
    seed: int,
    report: Callable,
    programs: dict[Hashable, Any] | None = None,
):
    """`(method, Deployed)` one after the other, for one seed with its policy. programs: what other
    seeds of it compiled.
    """
    cache: dict[str, Any] = {}
    arena = StepsArena(setting, ready, names, config.steps.tests, seed, programs)
    for k, method in enumerate(methods):

        def told(done, of, note="", k=k, method=method):
            report(k + done / max(of, 1), len(methods), f"{method} {note}".strip())

        told(0, 1)
        arena.own, arena.scored = [], []
        trip = STEPS[method](Bout(config, arena, np.array([seed]), told, cache))  # type: ignore[arg-type]
        yield method, deployed_of(method, trip, arena)


def deployed_of(method: str, trip: Trip, arena: StepsArena) -> Deployed:
    """What a method would deploy after each number of trials, and its return."""
    rewards = trip.rewards[:, 0]  # [T, N, I]
    T = len(rewards)
    trials = arena.one.trials
    if method in TRIED:
        own = np.stack([s.reshape(T, -1) for s in arena.own], -1)  # [T, N, I]

        def order(x):
            return np.moveaxis(x, 1, 2).reshape(
                T, -1
            )  # as they were made: all starts of a visit, then the next

        told, tests = order(np.where(np.isfinite(own), own, -np.inf)), order(rewards)
        best = np.array(
            [[np.argmax(x) for x in _expected(told[t], trip, t, arena)] for t in range(T)]
        )
        return Deployed(
            (trials * np.arange(1, told.shape[1] + 1), np.take_along_axis(tests, best, 1))
        )
    if method.startswith("sysid"):
        return Deployed((trials * np.arange(rewards.shape[2]), rewards[:, 0]))
    return Deployed((np.asarray(trip.spent), rewards[:, 0]))


def _expected(told: np.ndarray, trip: Trip, t: int, arena: StepsArena) -> Iterator[np.ndarray]:
    """Of the returns `told [n]` in target t those that are expected after each visit: all so far,
    smoothed by `phase2.smoothed`.
    """
    if trip.means is None:
        yield from (told[: n + 1] for n in range(len(told)))
        return
    means = jnp.asarray(np.moveaxis(trip.means[t, 0], 0, 1).reshape(len(told), -1), jnp.float32)
    for n in range(len(told)):
        unknown = jnp.where(
            jnp.arange(len(told)) <= n, jnp.asarray(told), -jnp.inf
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


def rows_of(
    found: dict[str, list[Deployed]], methods: list[str], names: list[str]
) -> list[dict[str, Any]]:
    """A row for each method and target: normalised returns of what is deployed at last, the curve
    over trials, and at each budget.
    """
    lower, upper = bounds_of(found)
    out = []
    for method in methods:
        runs = found[method]
        for t, name in enumerate(names):

            def norm(x, t=t):
                return (np.asarray(x) - lower[t]) / (upper[t] - lower[t])

            curves = norm([d.returns[t] for d in runs])
            line = row(
                method,
                name,
                curves[:, -1:],
                oracle=1.0,
                target_trials=None if method in BOUNDS else int(runs[0].trials[-1]),
            )
            line["curve"] = {
                "median": np.median(curves, 0),
                "mean": curves.mean(0),
                "q25": np.percentile(curves, 25, axis=0),
                "q75": np.percentile(curves, 75, axis=0),
            }
            line["trials"] = runs[0].trials
            line["returns"] = [float(d.returns[t, -1]) for d in runs]
            line["at"] = {str(b): _interval(norm([d.at(b)[t] for d in runs])) for b in BUDGETS}
            out.append(plain(line))
    return out


def _interval(values: np.ndarray) -> dict[str, Any] | None:
    if not np.isfinite(values).all():
        return None
    low, high = bootstrap_interval(values)
    return {"mean": float(values.mean()), "low": low, "high": high, "per_seed": values}


def _about(setting: Setting, names: list[str], found: dict[str, list[Deployed]]) -> dict[str, Any]:
    lower, upper = bounds_of(found)
    if room := [
        n for n, a, b in zip(names, lower, upper, strict=True) if b - a < 1.5 * ROOM * abs(b) + 1e-6
    ]:
        print(
            f"compare: UDR is as good as the oracle in {', '.join(room)}: nothing can be told "
            f"apart there",
            file=sys.stderr,
        )
    return {
        "simulator": f"{setting.sim.name} in MJX"
        if setting.sim.native is not None
        else setting.sim.name,
        "target_backend": ", ".join(dict.fromkeys(setting.targets[n].engine for n in names)),
        "trials_axis": True,
        "reward": "return of what is deployed: 0 UDR, 1 the oracle or the best in Omega",
        "oracle": "the policy that knows E, trained on in the target",
        "settings": {
            n: {
                "params": dict(
                    zip(
                        [f.name for f in setting.fields],
                        map(float, setting.targets[n].values),
                        strict=True,
                    )
                ),
                "udr_return": float(lower[t]),
                "best_return": float(upper[t]),
            }
            for t, n in enumerate(names)
        },
    }
