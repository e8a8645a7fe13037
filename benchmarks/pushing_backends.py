"""The push in every engine, side by side in one run: speeds with their ratios, MJX's compile time,
Drake's own spread.

    # speeds over 200 pushes; MJX compiles cold (no cache)
    python benchmarks/pushing_backends.py
    python benchmarks/pushing_backends.py --samples 64 --repeats 3
    # final positions against steps of 2 ms
    python benchmarks/pushing_backends.py --drake-steps 0.001 0.0025 0.005

CPU seconds stand beside wall seconds: on a busy machine only they can be compared. Engines take
turns, so that a slow minute hits all of them. Without Drake (`pip install -e .[drake]`) the others
are timed.
"""

import argparse
import os
import time

os.environ.pop("JAX_COMPILATION_CACHE_DIR", None)
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from adaptsim_jax import BadInput
from adaptsim_jax.tasks.pushing import model as pushing
from adaptsim_jax.tasks.pushing.engines import make_backend

SHARE = {
    "planar": 4096,
    "drake": 12,
}  # pushes that a turn of these is worth; the others take --samples


def timed(simulate, batch):
    begin, cpu = time.perf_counter(), time.process_time()
    np.asarray(simulate(*batch).state)
    return time.perf_counter() - begin, time.process_time() - cpu


def resized(batch, count):
    return tuple(np.resize(a, (count, a.shape[1])) for a in batch)


def speeds(samples: int, repeats: int, seed: int) -> None:
    batch = pushing.draw(seed, samples)
    engines, batches = {}, {}
    for name in ("native", "mjx", "planar", "drake"):
        try:
            engines[name] = make_backend(name).simulate
        except BadInput as error:
            print(f"{name}: {error}")
            continue
        batches[name] = resized(batch, SHARE.get(name, samples))
        if name != "drake":  # which compiles nothing
            wall, cpu = timed(engines[name], batches[name])
            print(
                f"{name:8} first call, compile included: {wall:6.1f} s wall, {cpu:6.1f} s CPU",
                flush=True,
            )
    turns = {name: [] for name in engines}
    for _ in range(repeats):
        for name, simulate in engines.items():
            turns[name].append(timed(simulate, batches[name]))
    rate = {}
    for name, times in turns.items():
        wall, cpu = np.median(np.array(times), 0)
        rate[name] = len(batches[name][0]) / np.array([wall, cpu])
        print(
            f"{name:8} {rate[name][0]:10.1f} pushes/s   {rate[name][1]:10.1f} pushes/CPU s   "
            f"({len(batches[name][0])} a turn)"
        )
    for fast, slow, bar in (
        ("native", "drake", 5),
        ("native", "mjx", 4),
        ("planar", "native", 100),
    ):
        if fast in rate and slow in rate:
            wall, cpu = rate[fast] / rate[slow]
            print(
                f"{fast} : {slow} = {wall:.1f} by the wall clock, {cpu:.1f} by CPU time (bar: "
                f"{bar})"
            )


def drake_steps(samples: int, steps: list[float], seed: int) -> None:
    from adaptsim_jax.tasks.pushing.engines.drake import PushContact

    batch = pushing.draw(seed, samples)

    def place(dt):
        return make_backend("drake", contact=PushContact(dt=dt)).simulate(*batch).state[:, -1, :2]

    usual = place(PushContact.dt)
    for dt in steps:
        apart = 1e3 * np.linalg.norm(place(dt) - usual, axis=1)
        median, p90, most = np.percentile(apart, [50, 90, 100])
        print(
            f"drake {1e3 * dt:g} ms against {1e3 * PushContact.dt:g} ms: median {median:.1f} p90 "
            f"{p90:.1f} max {most:.1f} mm"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--samples", type=int, default=200)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--drake-steps", type=float, nargs="+", metavar="S")
    args = parser.parse_args()
    if args.drake_steps:
        drake_steps(args.samples, args.drake_steps, args.seed)
    else:
        speeds(args.samples, args.repeats, args.seed)
