"""Table 1's AdaptSim row for the pendulum: one Phase 1 for each seed, then Phase 2 in the five
settings.

    python experiments/phase1_pendulum.py train --out DIR [--first 0] [--seeds 20] [--config \\
        recommended|paper-pendulum]
    python experiments/phase1_pendulum.py score --out DIR

`train` can be stopped and run again: finished seeds are kept. `score` prints the tables and writes
`scores.json` into DIR.
"""

import argparse
import json
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax import TrainConfig, make_phase1, make_task
from adaptsim_jax.adaptation.phase1 import DistributionArchive
from adaptsim_jax.adaptation.phase2 import TrainedMany, stack, starts_of, train_many, train_one
from adaptsim_jax.adaptation.training import PRESETS, preset
from adaptsim_jax.core import config as configs
from adaptsim_jax.core.files import atomic_file
from adaptsim_jax.core.progress import progress

STARTS, ITERATIONS = 2, 10


def config_of(name: str) -> TrainConfig:
    return TrainConfig() if name == "recommended" else preset(name)


def phase1_of(config: TrainConfig):
    return make_phase1(make_task("pendulum", config.task), config.phase1)


def train(out: Path, name: str, wanted: range) -> None:
    """One file a seed: weights, the starts drawn from its S_E, and its learning curve."""
    config = config_of(name)
    phase1 = phase1_of(config)
    out.mkdir(parents=True, exist_ok=True)
    (out / "config.json").write_text(json.dumps({"name": name, **configs.to_table(config)}))
    seeds = np.array([s for s in wanted if not (out / f"seed-{s}.npz").exists()])
    if not len(seeds):
        return
    program, hyper = jax.jit(partial(train_one, phase1)), stack([config.hyper])
    with progress(f"{name}, {len(seeds)} seeds") as report:
        for i, seed in enumerate(seeds):
            part = train_many(phase1, hyper, seeds[i : i + 1], program=program)
            starts = starts_of(phase1, part, seeds[i : i + 1], STARTS)
            with atomic_file(out / f"seed-{seed}.npz") as file:
                np.savez(
                    file,
                    weights=part.weights[0],
                    starts=starts.mean[0],
                    reward=part.info.final_reward[0],
                )
            report(i + 1, len(seeds), f"reward {float(part.info.final_reward[0, -1]):.2f}")


def load(out: Path):
    """Phase 1, its config, and the runs that are there, as `adapt_many` takes them."""
    table = json.loads((out / "config.json").read_text())
    name = table.pop("name")
    config = configs.from_table(TrainConfig, table, str(out / "config.json"))
    phase1 = phase1_of(config)
    files = sorted(out.glob("seed-*.npz"), key=lambda f: int(f.stem.split("-")[1]))
    runs = [dict(np.load(f)) for f in files]
    means = jnp.asarray(np.stack([r["starts"] for r in runs]))
    weights = jnp.asarray(np.stack([r["weights"] for r in runs]))
    hyper = stack([config.hyper] * len(runs))
    return name, phase1, TrainedMany(hyper, weights, None, None), with_policies(phase1, means)


def with_policies(phase1, means: jax.Array) -> DistributionArchive:
    """Starts `[S, N, D]` with blank task policies: the pendulum's are solved anew at each visit."""
    blank = phase1.task.init_policy(jax.random.key(0))
    return DistributionArchive(
        means, jax.tree.map(lambda x: jnp.broadcast_to(x, (*means.shape[:2], *x.shape)), blank)
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=["train", "score"])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument(
        "--first", type=int, default=0, help="the first seed, to share the work among processes"
    )
    parser.add_argument("--config", default="recommended", choices=["recommended", *PRESETS])
    args = parser.parse_args()
    if args.what == "train":
        train(args.out, args.config, range(args.first, args.seeds))
    else:
        from phase1_pendulum_score import score

        score(args.out)


if __name__ == "__main__":
    main()
