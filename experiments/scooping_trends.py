"""Which way success goes with each property of the piece and each part of the action, in the
hydroelastic engine or in Drake.

    python experiments/scooping_trends.py --samples 256 --out trends.json
    python experiments/scooping_trends.py --samples 48 --backend drake

A trend is a difference of success rates between a high and a low value of one quantity, all others
drawn at random over Omega and the actions and the same in both (common random numbers). Intervals
are 95 %, by bootstrap over the pairs.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from adaptsim_jax.core import process
from adaptsim_jax.core.files import write_json
from adaptsim_jax.tasks.scooping import engines as backends
from adaptsim_jax.tasks.scooping import model


class Quantity(NamedTuple):
    """A column of the trials `[params, action]`, and what is low and high of it."""

    column: int
    low: float
    high: float
    text: str


QUANTITIES = {
    "friction": Quantity(0, 0.26, 0.39, "0.26 -> 0.39"),
    "modulus": Quantity(1, 1.5e4, 3.5e5, "15 kPa -> 350 kPa"),
    "height": Quantity(3, 0.016, 0.024, "16 mm -> 24 mm"),
    "pitch": Quantity(4, np.radians(3.0), np.radians(9.0), "3 -> 9 degrees"),
    "rate": Quantity(5, -0.15, 0.15, "-0.15 (early lift) -> 0.15 rad/s (late)"),
    "distance": Quantity(6, 0.007, 0.018, "7 mm -> 18 mm"),
}
Simulate = Callable[[np.ndarray, np.ndarray], np.ndarray]


def pairs(shape: int, quantity: Quantity, samples: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """`(params [2 N, 4], actions [2 N, 3])`: N random trials at the low value, then the same ones
    at the high value.
    """
    params, actions = model.draw(seed, samples)
    rows = np.concatenate([params, actions], 1)
    rows[:, 2] = shape
    both = np.concatenate([rows, rows])
    both[:samples, quantity.column], both[samples:, quantity.column] = quantity.low, quantity.high
    return both[:, :4], both[:, 4:]


def bootstrap(gain: np.ndarray, seed: int = 0, draws: int = 4000) -> tuple[float, float]:
    """95 % interval of the mean of `gain [N]`."""
    rng = np.random.default_rng(seed)
    means = gain[rng.integers(0, len(gain), (draws, len(gain)))].mean(1)
    return float(np.quantile(means, 0.025)), float(np.quantile(means, 0.975))


def trend(simulate: Simulate, shape: int, name: str, samples: int, seed: int) -> dict:
    """Success at both values, their difference, and its interval. `simulate(params, actions) ->
    success [2 N]`.
    """
    won = simulate(*pairs(shape, QUANTITIES[name], samples, seed))
    low, high = won[:samples], won[samples:]
    least, most = bootstrap(high - low, seed)
    return {
        "shape": model.SHAPES[shape],
        "quantity": name,
        "low": float(low.mean()),
        "high": float(high.mean()),
        "difference": float((high - low).mean()),
        "interval": [least, most],
        "samples": samples,
    }


def engine(backend: str) -> Simulate:
    simulate = backends.make_backend(backend).simulate
    return lambda p, a: model.outcome(simulate(p, a, np.zeros((len(p), 2))).state)[0]


def line(row: dict) -> str:
    """A row of a Markdown table."""
    least, most = row["interval"]
    sure = "" if least <= 0.0 <= most else " *"
    what = f"{row['quantity']}, {QUANTITIES[row['quantity']].text}"
    numbers = (
        f"{row['low']:.2f} | {row['high']:.2f} | {row['difference']:+.2f} | {least:+.2f} .. "
        f"{most:+.2f}{sure}"
    )
    return f"| {row['shape']} | {what} | {numbers} |"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--samples", type=int, default=256, help="pairs for each trend (256)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--backend", default="hydro", choices=backends.BACKENDS)
    parser.add_argument(
        "--shapes", nargs="+", default=["ellipsoid", "cylinder"], choices=model.SHAPES
    )
    parser.add_argument("--quantities", nargs="+", default=list(QUANTITIES), choices=QUANTITIES)
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    process.enable_cache()
    simulate, rows = engine(args.backend), []
    print(
        "| shape | quantity | success, low | high | difference | 95 % interval (* excludes 0) "
        "|\n|---|---|---|---|---|---|"
    )
    for shape in args.shapes:
        for name in args.quantities:
            rows.append(trend(simulate, model.SHAPES.index(shape), name, args.samples, args.seed))
            print(line(rows[-1]), flush=True)
    if args.out:
        write_json(
            args.out, {"schema": 1, "backend": args.backend, "seed": args.seed, "rows": rows}
        )


if __name__ == "__main__":
    main()
