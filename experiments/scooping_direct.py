"""Phase 1 of scooping with the bank of simulated trials beside the direct way, at a reduced size:
rewards of visits, and time.

    python experiments/scooping_direct.py --out direct.json

All of it explores (epsilon 1), so that the three ways visit the same means of E in the same
targets, in trials with the same luck:

bank       policies trained on the bank, targets rehearsed in the bank: what Phase 1 does by default
rehearsed  policies trained on the bank, targets simulated
direct     policies trained on simulated trials, targets simulated
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax import default_config, make_phase1, make_task
from adaptsim_jax.adaptation.phase1 import Phase1Config
from adaptsim_jax.core import process
from adaptsim_jax.core.files import write_json

WAYS = {
    "bank": ("bank", "bank"),
    "rehearsed": ("bank", "simulator"),
    "direct": ("simulator", "simulator"),
}
DRAWS = 2000  # of the bootstrap


def visits(way: str, sizes: Phase1Config, seed: int) -> tuple[np.ndarray, dict[str, Any]]:
    """Rewards `[trajectories, horizon]` of all visits but each trajectory's first, and what they
    took.
    """
    source, rehearsal = WAYS[way]
    base = default_config("scooping")
    phase1 = make_phase1(
        make_task("scooping", {**base.task, "source": source, "rehearsal": rehearsal}), sizes
    )
    hyper = replace(base.hyper, epsilon_start=1.0, epsilon_end=1.0, gain=1.0, soft=0.0)
    run = jax.jit(lambda state, rounds: phase1.run(state, hyper, rounds))
    state, rounds = jax.jit(phase1.init)(jax.random.key(seed)), jnp.arange(sizes.rounds)
    begin = time.process_time()
    compiled = run.lower(state, rounds).compile()
    ready, wall = time.process_time(), time.perf_counter()
    state, _ = jax.block_until_ready(compiled(state, rounds))
    took = {
        "compile_cpu_s": ready - begin,
        "cpu_s": time.process_time() - ready,
        "wall_s": time.perf_counter() - wall,
    }
    rewards = np.asarray(state.replay.reward)[: sizes.trajectories * sizes.horizon]
    policies = {} if state.pool is None else {"policies": int(state.pool.count)}
    return rewards.reshape(sizes.trajectories, sizes.horizon), took | policies


def beside(rewards: np.ndarray, direct: np.ndarray, seed: int) -> dict[str, float]:
    """How `rewards [n, I]` differ from those of the `direct` way, trajectories being what is drawn
    anew in the interval.
    """
    rng = np.random.default_rng(seed)
    gap = (rewards - direct).mean(1)
    low, high = np.quantile(
        gap[rng.integers(len(gap), size=(DRAWS, len(gap)))].mean(1), (0.025, 0.975)
    )
    alike = np.corrcoef(rewards.ravel(), direct.ravel())[0, 1]
    found = {"difference": gap.mean(), "low": low, "high": high, "correlation": alike}
    return {name: float(value) for name, value in found.items()} | {
        "root_mean_square": float(np.sqrt(((rewards - direct) ** 2).mean()))
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--trajectories", type=int, default=20)
    parser.add_argument("--parallel", type=int, default=10, help="of them at once")
    parser.add_argument("--horizon", type=int, default=5)
    parser.add_argument("--trials", type=int, default=1200, help="of each policy's training")
    parser.add_argument(
        "--near",
        type=float,
        default=0.6,
        help="policies are lent within this distance (presets: 0.16)",
    )
    parser.add_argument("--seed", type=int, default=200)
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    process.enable_cache()
    base = default_config("scooping").phase1
    lent = replace(
        base.reuse, threshold=args.near, first=args.trials, most=args.trials, least=args.trials // 2
    )
    count = args.trajectories * args.horizon
    sizes = replace(
        base,
        trajectories=args.trajectories,
        parallel=args.parallel,
        horizon=args.horizon,
        updates=1,
        capacity=count,
        reuse=lent,
    )
    found, rewards = {}, {}
    for way in WAYS:
        rewards[way], found[way] = visits(way, sizes, args.seed)
        found[way] |= {
            "reward": float(rewards[way].mean()),
            "best": float(rewards[way].max(1).mean()),
        }
        print(way, {k: round(v, 3) for k, v in found[way].items()}, flush=True)
    for way in ("bank", "rehearsed"):
        found[way] |= beside(rewards[way], rewards["direct"], args.seed)
        found[way] |= {"speedup": found["direct"]["cpu_s"] / found[way]["cpu_s"]}
        print(
            way,
            "beside direct:",
            {k: round(float(v), 3) for k, v in found[way].items()},
            flush=True,
        )
    if args.out:
        kept = {way: r.tolist() for way, r in rewards.items()}
        write_json(
            args.out,
            {"sizes": vars(args) | {"out": str(args.out)}, "found": found, "rewards": kept},
        )


if __name__ == "__main__":
    main()
