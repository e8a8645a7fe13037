"""Scores of trained seeds (see `phase1_pendulum.py`), recomputed in double precision from the means
of E visited.
"""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from phase1_pendulum import ITERATIONS, load, with_policies
from reachable import ceiling

from adaptsim_jax.adaptation.phase2 import adapt_many
from adaptsim_jax.baselines.bounds import best_in_omega, costs, pendulum_problem, udr


def tuning_targets(outside: int = 64, inside: int = 32) -> np.ndarray:
    """Targets that settings were chosen on: one or two parameters out of range as in table A2, none
    of its five.
    """
    rng = np.random.default_rng(7)

    def one():
        params = rng.uniform(1, 2, 4)
        for i in rng.choice(4, rng.choice([1, 2]), replace=False):
            if i < 2:
                params[i] = rng.choice([rng.uniform(0.33, 0.75), rng.uniform(2.2, 3.0)])
            else:
                params[i] = rng.choice([rng.uniform(4, 11), rng.uniform(0.4, 0.8)], p=[0.75, 0.25])
        return params

    return np.array([one() for _ in range(outside)] + [rng.uniform(1, 2, 4) for _ in range(inside)])


def score(out: Path) -> None:
    name, phase1, trained, starts = load(out)
    task = phase1.task
    problem = pendulum_problem(task.space)
    five = np.array([task.space.values(s) for s in task.settings.values()])
    tuning = tuning_targets()
    targets = np.concatenate([five, tuning])
    history = adapt_many(phase1, trained, starts, targets, iterations=ITERATIONS)
    means = np.moveaxis(np.asarray(history.mean), 1, 0)  # [T, S, N, I + 1, D]
    low, high, goals = _bounds(problem, targets, out / "bounds.npz")

    def scaled(cost):  # [T, ...]
        def column(x):
            return x[: len(cost)].reshape(-1, *[1] * (cost.ndim - 1))

        return (column(low) - cost) / (column(low) - column(high))

    normal = scaled(costs(problem, means, targets))
    best, final = normal.max((2, 3)), normal[..., -1]
    grid = scaled(_grid_costs(problem, means[:5, :, :, 0], five, goals[:5]))
    result = {
        "config": name,
        "seeds": len(starts.mean),
        "settings": {
            setting: _summary(best[i], final[i], grid[i]) for i, setting in enumerate(task.settings)
        },
        "tuning": {
            "outside": {
                "best": float(best[5:69].mean()),
                "final_best_start": float(final[5:69].max(-1).mean()),
            },
            "inside": {
                "best": float(best[69:].mean()),
                "final_best_start": float(final[69:].max(-1).mean()),
            },
        },
        "in_range_from_centre": _from_centre(phase1, trained, problem),
    }
    (out / "scores.json").write_text(json.dumps(result, indent=1))
    print(json.dumps(result, indent=1))


def _bounds(problem, targets, file: Path):
    """Costs `[T]` that Table 1 maps to 0 (UDR) and to 1 (the best of Omega in that target), and the
    best means `[T, D]`.

    Minutes of work that no seed changes: kept in `file`.
    """
    if file.exists():
        kept = np.load(file)
        if np.array_equal(kept["targets"], targets):
            return kept["low"], kept["high"], kept["goals"]
    policy = udr(problem).policy
    with jax.enable_x64(True):
        low = np.asarray(
            jax.vmap(lambda t: problem.cost(t, jnp.asarray(policy)))(jnp.asarray(targets))
        )
    best = best_in_omega(problem, targets)
    np.savez(file, targets=targets, low=low, high=best.cost, goals=best.mean)
    return low, best.cost, best.mean


def _grid_costs(problem, starts, targets, goals):
    """The least cost that the step grid reaches from the two starts of each seed: `[T, S, N, D] ->
    [T, S]`.
    """
    return np.array(
        [
            ceiling(problem, s.reshape(-1, s.shape[-1]), t, g, delta=0.1, steps=ITERATIONS)[1]
            .reshape(s.shape[:2])
            .min(-1)
            for s, t, g in zip(starts, targets, goals, strict=True)
        ]
    )


def _summary(best, final, grid):
    rng = np.random.default_rng(0)
    draws = best[rng.integers(len(best), size=(10_000, len(best)))].mean(1)
    return {
        "mean": float(best.mean()),
        "low": float(np.quantile(draws, 0.025)),
        "high": float(np.quantile(draws, 0.975)),
        "median": float(np.median(best)),
        "q25": float(np.quantile(best, 0.25)),
        "q75": float(np.quantile(best, 0.75)),
        "final_best_start": float(final.max(-1).mean()),
        "final_mean_start": float(final.mean()),
        "ceiling": float(grid.mean()),
        "per_seed": [round(float(x), 4) for x in best],
    }


def _from_centre(phase1, trained, problem, count: int = 100):
    """Scaled reward 1 - 10 (J / J* - 1) on random in-range targets from the centre of Omega, one
    start, for each seed.
    """
    targets = np.random.default_rng(11).uniform(1, 2, (count, 4))
    starts = with_policies(phase1, jnp.full((len(trained.weights), 1, 4), 0.5))
    history = adapt_many(phase1, trained, starts, targets, iterations=ITERATIONS)
    means = np.moveaxis(np.asarray(history.mean), 1, 0)[:, :, 0]
    own = problem.space.unit(jnp.asarray(targets, jnp.float32))
    optimum = costs(problem, np.asarray(own)[:, None], targets)[:, 0]
    reward = 1 - 10 * (costs(problem, means, targets) / optimum[:, None, None] - 1)  # [T, S, I + 1]
    by_seed = reward[..., -1].mean(0)
    return {
        "last": float(by_seed.mean()),
        "last_worst_seed": float(by_seed.min()),
        "best_iteration": float(reward.max(-1).mean()),
        "by_iteration": [round(float(x), 4) for x in reward.mean((0, 1))],
    }
