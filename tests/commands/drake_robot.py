"""A robot for tests: make the pushes of an actions.csv in Drake, and write what a camera over the
table would see.

    python tests/commands/drake_robot.py robot/actions.csv measured.csv --params 0.3,1e5,0.15,0.1

It knows of the package only the engine, reads and writes files alone, and runs in a process of its
own. The camera sees 60 frames a second to the nearest 0.1 mm, from the arm's start on, and a little
longer than the trial.
"""

import argparse
import csv
from dataclasses import replace

import numpy as np

from adaptsim_jax.tasks.pushing.engines import make_backend
from adaptsim_jax.tasks.pushing.model import PAPER, START

FRAMES = 60.0  # a second


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("actions")
    parser.add_argument("out")
    parser.add_argument("--params", required=True, help="mu,e,mu_p,y_p of the world")
    args = parser.parse_args()
    with open(args.actions, newline="") as file:
        asked = list(csv.DictReader(file))
    options = replace(PAPER, duration=1.4)
    actions = np.array([[float(row["speed"]), float(row["angle"])] for row in asked])
    params = np.tile([float(x) for x in args.params.split(",")], (len(actions), 1))
    starts = np.tile(START, (len(actions), 1))
    state, code = make_backend("drake", options).simulate(params, actions, starts)
    assert not np.any(code), code
    seen = np.arange(0.0, options.duration, 1 / FRAMES)
    simulated = options.row * np.arange(state.shape[1] + 1)
    with open(args.out, "w", newline="") as file:
        write = csv.writer(file)
        write.writerow(["trial", "time", "x", "y"])
        for row, start, track in zip(asked, starts, state[..., :2], strict=True):
            places = np.concatenate([start[None], track])
            x, y = (np.interp(seen, simulated, places[:, k]) for k in range(2))
            write.writerows(
                (row["trial"], f"{t:.4f}", f"{a:.4f}", f"{b:.4f}")
                for t, a, b in zip(seen, x, y, strict=True)
            )


if __name__ == "__main__":
    main()
