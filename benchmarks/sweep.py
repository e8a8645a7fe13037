"""One call of `adaptsim sweep` beside as many calls of `adaptsim train`, two at a time, on the same
cores; compile included.

    # 64 members (4 values x 16 seeds) of 2,000 trajectories
    python benchmarks/sweep.py
    # time 8 of the calls of `train`, and count the rest as these
    python benchmarks/sweep.py --calls 8
    python benchmarks/sweep.py --trajectories 10000     the members as the paper trains them

Both start with an empty compile cache. CPU seconds (user and system, of all children) stand beside
wall seconds, because on a busy machine only they can be compared; two calls at a time keep two
cores busy, so that half their CPU seconds is what a quiet machine of two cores would take at best.
"""

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

SPEC = """task = "pendulum"
preset = "paper-pendulum"
seeds = {seeds}
[set]
phase1.trajectories = {trajectories}
[grid]
hyper.delta = [0.08, 0.1, 0.12, 0.15]
"""
DELTAS = (0.08, 0.1, 0.12, 0.15)


def timed(work) -> dict:
    """Wall and CPU seconds of the children that `work()` waits for."""
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    work()
    wall, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    return {
        "wall_s": wall,
        "cpu_s": after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
    }


def call(words: list[str], cache: Path) -> None:
    environment = os.environ | {"ADAPTSIM_CACHE": str(cache)}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    subprocess.run(
        [sys.executable, "-m", "adaptsim_jax", *words],
        env=environment,
        check=True,
        stdout=subprocess.DEVNULL,
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=16)
    parser.add_argument("--trajectories", type=int, default=2000)
    parser.add_argument(
        "--calls", type=int, help="calls of `train` to make (default: as many as members)"
    )
    args = parser.parse_args()
    members = len(DELTAS) * args.seeds
    calls = min(args.calls or members, members)
    room = Path(tempfile.mkdtemp())
    try:
        spec = room / "SPEC.toml"
        spec.write_text(SPEC.format(seeds=args.seeds, trajectories=args.trajectories))
        sweep = timed(
            lambda: call(["sweep", str(spec), "--out", str(room / "sweep")], room / "cache_sweep")
        )

        def train(i: int) -> None:
            words = [
                "train",
                "pendulum",
                "--run",
                str(room / f"run{i}"),
                "--preset",
                "paper-pendulum",
            ]
            words += ["--seed", str(i), "--set", f"phase1.trajectories={args.trajectories}"]
            call([*words, "--set", f"hyper.delta={DELTAS[i % len(DELTAS)]}"], room / "cache_train")

        def all_of(numbers) -> None:
            with ThreadPoolExecutor(2) as two:
                list(two.map(train, numbers))

        # the first two compile, the others find the programs in the cache: only the latter are
        # scaled up
        first = timed(lambda: all_of(range(min(2, calls))))
        rest = timed(lambda: all_of(range(2, calls)))
        scale = (members - 2) / max(calls - 2, 1)
        train_all = {key: first[key] + scale * rest[key] for key in first}
    finally:
        shutil.rmtree(room, ignore_errors=True)
    ratio = {key: train_all[key] / sweep[key] for key in sweep}
    about = {"members": members, "trajectories": args.trajectories, "train_calls_made": calls}
    print(json.dumps(about | {"sweep": sweep, "train": train_all, "ratio": ratio}, indent=1))


if __name__ == "__main__":
    main()
