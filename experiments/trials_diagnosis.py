"""Score `adaptsim diagnose` on worlds of pushes, scoops or tosses: a line a world, and the tally.

# or experiments/scooping_worlds.py
python experiments/pushing_worlds.py --suite singles --seed 5 --out worlds/
python experiments/trials_diagnosis.py worlds/
"""

import json
import sys
import time
from pathlib import Path

import numpy as np

from adaptsim_jax.core import process
from adaptsim_jax.logs.declared import declared_task
from adaptsim_jax.tasks.registry import TRIALS


def main(folder):
    process.small_steps()
    rows = []
    for path in sorted(p for p in Path(folder).iterdir() if (p / "truth.json").exists()):
        truth = json.loads((path / "truth.json").read_text())["kind"]
        judge = TRIALS[declared_task(path)]
        began = time.monotonic()
        report = judge(path)
        names = [e["name"] for e in report["effects"]]
        classes = [
            {e["name"], *(a.split("@")[0] for a in e["alternatives"])} for e in report["effects"]
        ]
        right = any(truth in c for c in classes)
        wrong = any(truth not in c for c in classes)
        error = report["error"]
        ratio = (error["after"] if names else error["before"]) / error["noise_floor"]
        rows.append((truth, report["verdict"], right, wrong, ratio, time.monotonic() - began))
        told = ", ".join("/".join([e["name"], *e["alternatives"]]) for e in report["effects"])
        print(
            f"{path.name:28s} {report['verdict']:24s} "
            f"{'right' if right else 'WRONG' if wrong else '-':6s} over floor "
            f"{error['before'] / error['noise_floor']:.2f} -> {ratio:.2f}  {rows[-1][-1]:.0f} s  "
            f"{told}",
            flush=True,
        )
    count = len(rows)

    def share(pick):
        return f"{sum(map(bool, map(pick, rows)))} of {count}"

    print(f"named {share(lambda r: r[1] in ('explained', 'explained_class', 'partly_explained'))}")
    print(
        f"right {share(lambda r: r[2])}, right and nothing else "
        f"{share(lambda r: r[2] and not r[3])}, wrong {share(lambda r: r[3])}"
    )
    print(
        "unattributed or partly "
        f"{share(lambda r: r[1] in ('structured_unattributed', 'partly_explained'))}"
    )
    seconds = [r[5] for r in rows]
    print(
        f"median over floor {np.median([r[4] for r in rows]):.2f}, seconds "
        f"{np.median(seconds):.0f}, at most {max(seconds):.0f}"
    )


if __name__ == "__main__":
    main(sys.argv[1])
