"""Make the bank of scooping trials that task policies are trained with, and say how good it is.

python experiments/scooping_bank.py --count 16384
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from adaptsim_jax.models.scooping import MESSAGES, ScoopOptions
from adaptsim_jax.models.scooping_hydro import Numerics
from adaptsim_jax.progress import progress
from adaptsim_jax.tasks import scooping_bank


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=16384, help="trials, a power of 2 (16384)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--clearance", type=float, default=ScoopOptions().clearance, help="m")
    parser.add_argument("--out", type=Path, default=scooping_bank.PATH)
    args = parser.parse_args()
    options, numerics = ScoopOptions(clearance=args.clearance), Numerics()
    params, actions = scooping_bank.points(args.count, args.seed)
    begin, cpu = time.perf_counter(), time.process_time()
    with progress("bank") as report:
        wins, codes = scooping_bank.simulate(params, actions, options, numerics, report)
    seconds, cpu = time.perf_counter() - begin, time.process_time() - cpu
    found = scooping_bank.fit(params, actions, wins, seed=args.seed)
    scooping_bank.save_bank(args.out, found, wins, args.seed, options, numerics)
    faults = {MESSAGES[c]: int((codes == c).sum()) for c in np.unique(codes) if c}
    print(
        f"{args.count} trials in {seconds:.0f} s ({args.count / seconds:.0f}/s by wall, {args.count / cpu:.0f} a CPU second)"
    )
    print(f"succeeded: {wins.mean():.3f}; faults: {faults or 'none'}")
    print(f"network, held-out tenth: accuracy {found.accuracy:.3f}, log loss {found.log_loss:.3f}")
    print(f"written: {args.out}")


if __name__ == "__main__":
    main()
