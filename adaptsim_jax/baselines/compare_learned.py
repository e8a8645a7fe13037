"""`adaptsim compare` for tasks whose policies are learned: the methods tried in a world, and the
rows of results.json.

Rewards are as the task gives them (for the push, as in the paper's Table 1, 20 cm is the most that
counts): no normalising between UDR and the best of Omega. The oracle is what the best action for
each test context earns in the target itself.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.baselines.arena import Arena
from adaptsim_jax.baselines.config import CompareConfig
from adaptsim_jax.baselines.learned import Bout, Trip
from adaptsim_jax.baselines.parts import parts_of
from adaptsim_jax.baselines.registry import LEARNED, ORACLE, learned_methods
from adaptsim_jax.baselines.summary import bootstrap_interval, physical, row
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.progress import silent
from adaptsim_jax.tasks.one_shot import OneShot, TargetWorld


def compare_learned(
    one: OneShot,
    names: list[str],
    config: CompareConfig,
    progress: Callable = silent,
    out: str | Path | None = None,
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Rows of `config.methods` (all) in the settings `names`, and what else results.json says of
    them.
    In `out` each method's part is kept.
    """
    targets = np.array([one.task.space.values(one.task.settings[name], name) for name in names])
    world = one.world(config.target or one.engine, **config.target_options)
    methods = [m.replace("-", "_") for m in config.methods] or list(learned_methods())
    for method in methods:
        if method not in learned_methods():
            raise BadInput(
                f"compare: method '{method}' needs a task that is solved exactly; for "
                f"{one.task.name} there is: "
                f"{', '.join(learned_methods())}"
            )
    progress(0, len(methods) + 1, "oracle")
    parts = parts_of(out, one.task.name, config)
    oracle = np.array(
        parts.of("oracle-rewards", lambda: [float(np.mean(one.oracle(world, t))) for t in targets])
    )
    seeds, rows, cache = np.arange(config.seed, config.seed + config.seeds), [], {}
    for i, method in enumerate(methods):

        def report(done, of, note="", i=i, method=method):
            progress(1 + i + done / max(of, 1), len(methods) + 1, f"{method} {note}".strip())

        report(0, 1)
        if method == ORACLE:
            curves = np.broadcast_to(oracle[:, None, None], (len(names), config.seeds, 1))
            rows += [
                row(method, n, c, oracle=o, target_trials=None)
                for n, c, o in zip(names, curves, oracle, strict=True)
            ]
        else:

            def made(method=method, report=report):
                arena = Arena(one, world, targets)
                trip = travelled(method, Bout(config, arena, seeds, report, cache))
                return trip_rows(
                    method, names, trip, oracle, one.task.space, arena.failed, arena.made
                )

            rows += parts.of(method, made)
        report(1, 1)
    return rows, about(one, world, names, targets, oracle) | {"digest": parts.digest}


def travelled(method: str, bout: Bout) -> Trip:
    """What `method` did, with what its policies earned in the fresh contexts."""
    trip, fresh = LEARNED[method](bout), bout.arena.fresh
    if fresh:
        return trip._replace(fresh=np.stack(fresh, -1).reshape(trip.rewards.shape))
    return trip


def trip_rows(
    method: str,
    names: list[str],
    trip: Trip,
    oracle: np.ndarray,
    space: Any,
    failed: np.ndarray,
    made: np.ndarray,
) -> list[dict[str, Any]]:
    """A row for each target: at each iteration the best of the distributions that a method adapts
    at once.

    `oracle [T]`: rewards; `failed`, `made` `[T]`: trials, as the arena counted them.
    """
    out = []
    for i, name in enumerate(names):
        extras: dict[str, Any] = {
            "trials": trip.spent,
            "failed": int(failed[i]),
            "made": int(made[i]),
            "of_oracle": trip.rewards[i].max(axis=1).max(axis=1).mean() / oracle[i]
            if oracle[i]
            else None,
        }
        if trip.means is not None:
            S = trip.rewards.shape[1]
            best = trip.rewards[i].reshape(S, -1).argmax(1)
            flat = trip.means[i].reshape(S, -1, space.dim)[np.arange(S), best]
            last = trip.means[i][:, :, -1].reshape(-1, space.dim)
            extras |= {"best_params": physical(space, flat), "final_params": physical(space, last)}
        if trip.fresh is not None:
            extras["fresh"] = on_fresh(trip.rewards[i], trip.fresh[i])
        curves = trip.rewards[i].max(axis=1)
        out.append(
            row(method, name, curves, oracle=oracle[i], target_trials=int(trip.spent[-1]), **extras)
        )
    return out


def on_fresh(rewards: np.ndarray, fresh: np.ndarray) -> dict[str, Any]:
    """What policies earn in contexts that did not choose them, `rewards` and `fresh` `[S, N, I +
    1]`: of each seed's best by the tests its mean, 95 % interval and values, where several are best
    the mean of those; and the mean of the last iteration's.
    """
    S = len(rewards)
    flat, kept = rewards.reshape(S, -1), fresh.reshape(S, -1)
    best = flat == flat.max(1, keepdims=True)
    chosen = (kept * best).sum(1) / best.sum(1)
    low, high = bootstrap_interval(chosen)
    return {
        "mean": chosen.mean(),
        "low": low,
        "high": high,
        "per_seed": chosen,
        "final_mean": fresh[..., -1].mean(),
    }


def about(
    one: OneShot, world: TargetWorld, names: list[str], targets: np.ndarray, oracle: np.ndarray
) -> dict[str, Any]:
    return {
        "simulator": one.simulator,
        "target_backend": world.name,
        "reward": one.reward_unit,
        "oracle": one.oracle_means,
        "settings": {
            name: {"params": [float(p) for p in target], "oracle_reward": float(best)}
            for name, target, best in zip(names, targets, oracle, strict=True)
        },
    }
