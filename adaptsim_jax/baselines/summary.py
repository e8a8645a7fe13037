"""From costs in the targets to the rows of results.json: normalised as in the paper's Table 1, with
intervals.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from adaptsim_jax.space import Space

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
) -> dict[str, Any]:
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
