"""Table 1 of the paper, pushing or scooping columns, in parts that can be stopped and gone on with:
a file for each method and seed.

    # planar as simulator and target
    python experiments/table1_pushing.py --out OUT --seeds 10
    # deployed in Drake
    python experiments/table1_pushing.py --out OUT --seeds 10 --target drake
    # the MuJoCo scene as both
    python experiments/table1_pushing.py --out OUT --seeds 10 --simulator native --methods \\
        adaptsim
    python experiments/table1_pushing.py --out OUT --settings wd --target drake --bottle heavy \\
        --iterations 12 \\
        # Table 2: 4 trials an iteration
        --methods adaptsim learn_in_target udr_target bayesopt
    # hydroelastic engine, or --target drake
    python experiments/table1_pushing.py --task scooping --out OUT --seeds 10

`adaptsim compare TASK` is the same in one go. What is there is not computed again; `table.md` shows
what is there so far.
"""

import argparse
import shlex
import sys
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np

from adaptsim_jax import default_comparison, make_one_shot
from adaptsim_jax.adaptation.training import preset
from adaptsim_jax.baselines.arena import Arena, MethodRun, Visits
from adaptsim_jax.baselines.compare import stamped
from adaptsim_jax.baselines.compare_learned import about, run_method, visits_rows
from adaptsim_jax.core import process
from adaptsim_jax.core.files import atomic_file, output_folder, without_nan
from adaptsim_jax.report.comparison import table, write_comparison
from adaptsim_jax.tasks.pushing.engines.served import served_seconds

METHODS = (
    "udr",
    "learn_in_target",
    "udr_target",
    "sysid_point",
    "adaptsim",
    "sysid_bayes",
    "bayesopt",
)


def run_some(
    out: Path, method: str, seeds: list[int], config, one, world, targets, cache: dict
) -> None:
    """One method with some seeds together in every target; a file for each seed. `cache` holds what
    methods share.
    """

    def clock():
        return time.process_time() + served_seconds()

    begin, arena = clock(), Arena(one, world, targets)
    visits = run_method(method, MethodRun(config, arena, np.array(seeds), shared=cache))
    cpu = (clock() - begin) / len(seeds)
    for i, seed in enumerate(seeds):
        some = {"means": visits.means, "fresh": visits.fresh}
        some = {key: value[:, i : i + 1] for key, value in some.items() if value is not None}
        counts = {
            "failed": arena.failed * (i == 0),
            "made": arena.made * (i == 0),
        }  # of all, told once
        rewards = visits.rewards[:, i : i + 1]
        with atomic_file(path_of(out, method, seed)) as file:
            np.savez(file, rewards=rewards, spent=visits.spent, cpu=cpu, **counts, **some)
        print(
            f"{method}, seed {seed}: {rewards.max((2, 3))[:, 0].round(3)}, {cpu:.0f} s of CPU time",
            flush=True,
        )


def path_of(out: Path, method: str, seed: int) -> Path:
    return out / f"{method}-seed{seed:03d}.npz"


def rows_of(out: Path, method: str, names: list[str], oracle: np.ndarray, one) -> list[dict]:
    """Rows of all seeds of `method` that have a file."""
    parts = [np.load(path) for path in sorted(out.glob(f"{method}-seed*.npz"))]
    if not parts:
        return []

    def together(key):
        return np.concatenate([p[key] for p in parts], 1)

    means, fresh = (
        together(key) if all(key in part for part in parts) else None for key in ("means", "fresh")
    )
    visits = Visits(means, parts[0]["spent"], together("rewards"), fresh)
    counts = SimpleNamespace(one=one, **{k: sum(p[k] for p in parts) for k in ("failed", "made")})
    rows = visits_rows(method, names, visits, oracle, counts)
    return [row | {"cpu_seconds": float(sum(p["cpu"] for p in parts))} for row in rows]


def oracle_of(out: Path, one, world, targets: np.ndarray, without: bool) -> np.ndarray:
    """`[T]` rewards of the best actions in each target, computed once; not a number where they are
    not asked for.
    """
    kept = out / "oracle.npy"
    if not kept.exists() and without:
        return np.full(len(targets), np.nan)
    if not kept.exists():
        oracle = np.array([np.mean(one.oracle(world, target)) for target in targets])
        with atomic_file(kept) as file:
            np.save(file, oracle)
    return np.load(kept)


def main() -> None:  # noqa: PLR0915
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--task", default="pushing", choices=("pushing", "scooping"))
    parser.add_argument("--out", required=True)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument(
        "--together",
        type=int,
        default=5,
        help="seeds that share a compiled program, and are lost together",
    )
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--methods", nargs="+", default=METHODS[:-1], choices=METHODS)
    parser.add_argument("--settings", nargs="+", default=["wd", "ood-1", "ood-2", "ood-3", "ood-4"])
    parser.add_argument(
        "--target", default="", help="an engine; the task's own simulator by default"
    )
    parser.add_argument(
        "--simulator",
        default="planar",
        choices=("planar", "native"),
        help="of the push: what E is tried in",
    )
    parser.add_argument(
        "--visits",
        choices=("own", "deployed"),
        help="of the push: which actions are tried in the target",
    )
    parser.add_argument(
        "--tests", type=int, help="test contexts that rewards are averaged over (the task's)"
    )
    parser.add_argument(
        "--fresh",
        type=int,
        default=0,
        help="of scooping: contexts beyond the tests, in which all policies are scored again",
    )
    parser.add_argument("--bottle", default="paper")
    parser.add_argument(
        "--no-oracle",
        action="store_true",
        help="leave out the best actions, which are dear in Drake",
    )
    parser.add_argument("--iterations", type=int, default=8)
    parser.add_argument(
        "--sysid-visits",
        type=int,
        help="different visits that SysID's simulations share (natively 50, else one each)",
    )
    parser.add_argument(
        "--starts", type=int, default=2, help="distributions that AdaptSim adapts side by side"
    )
    args = parser.parse_args()
    process.enable_cache()
    out = output_folder(Path(args.out))
    sizes = {
        "iterations": args.iterations,
        "starts": args.starts,
        "seeds": args.seeds,
        "seed": args.first,
    }
    config = replace(default_comparison(args.task), **sizes)
    if args.simulator == "native":
        config = replace(config, train=preset("native-pushing"))
    visits = args.sysid_visits
    if visits is None:
        visits = 50 if args.simulator == "native" else 0
    config = replace(config, sysid=replace(config.sysid, visits=visits))
    options = dict(config.train.task)
    if args.visits:
        options["visits"] = args.visits
    if args.tests:
        options["tests"] = args.tests
    if args.fresh:
        options["fresh"] = args.fresh
    if args.target == "drake" and args.task == "pushing":
        options["coefficients"] = "drake"  # the planar twin of Drake is what we adapt in
    one = make_one_shot(args.task, options)
    world = one.world(
        args.target or one.engine, **({} if args.bottle == "paper" else {"bottle": args.bottle})
    )
    targets = np.array(
        [one.task.space.values(one.task.settings[name], name) for name in args.settings]
    )
    oracle = oracle_of(out, one, world, targets, args.no_oracle)
    for first in range(args.first, args.first + args.seeds, args.together):
        seeds, cache = range(first, min(first + args.together, args.first + args.seeds)), {}
        for method in args.methods:
            missing = [seed for seed in seeds if not path_of(out, method, seed).exists()]
            if missing:
                cache = cache if len(missing) == len(seeds) else {}
                run_some(out, method, missing, config, one, world, targets, cache)
                jax.clear_caches()
    rows = [row for method in METHODS for row in rows_of(out, method, args.settings, oracle, one)]
    command = shlex.join(["python", "experiments/table1_pushing.py", *sys.argv[1:]])
    results = (
        stamped(args.task, config, command)
        | about(one, world.name, args.settings, targets, oracle)
        | {"rows": rows}
    )
    results = without_nan(results) if args.no_oracle else results
    write_comparison(results, out)
    print(table(results))


if __name__ == "__main__":
    main()
