"""Command line: `python -m tests.generators.make --out DIR --seed 1 --effect coulomb:1:3
--condition clean`.
"""

import argparse
import json
from pathlib import Path

from tests.generators.conditions import CONDITIONS
from tests.generators.dataset import make_dataset
from tests.generators.recording import write_dataset


def main() -> None:
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("--out", required=True, type=Path)
    p.add_argument("--seed", type=int, default=0)
    p.add_argument("--condition", default="clean", choices=sorted(CONDITIONS))
    p.add_argument(
        "--effect", action="append", default=[], help="name:joint:multiple, joint 0 for the base"
    )
    p.add_argument("--world", default="rigid_body", choices=("rigid_body", "linearized"))
    p.add_argument("--engine", default="scipy", choices=("scipy", "mujoco"))
    p.add_argument("--trials", type=int, default=6)
    p.add_argument("--seconds", type=float, default=6.0)
    p.add_argument("--rate", type=float, default=200.0)
    p.add_argument("--truth", type=Path, help="also write what is hidden, as JSON, to this file")
    a = p.parse_args()
    hidden = [(n, int(j), float(m)) for n, j, m in (e.split(":") for e in a.effect)]
    sizes = {"n_trials": a.trials, "seconds": a.seconds, "rate": a.rate}
    ds = make_dataset(a.seed, a.condition, hidden, world=a.world, engine=a.engine, **sizes)
    print(write_dataset(ds, a.out))
    if a.truth:
        a.truth.write_text(json.dumps(ds.truth, indent=1))


if __name__ == "__main__":
    main()
