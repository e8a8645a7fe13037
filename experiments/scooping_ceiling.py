"""What the best single action of a target is worth on tests that it was not chosen by.

    python experiments/scooping_ceiling.py --out OUT --target drake --settings ood-4

The oracle of Table 1 is scored on the tests that it is chosen by, and so is the best of a method's
visits: where an action wins by luck, both are the luckiest of many. Here all actions of the
oracle's grid are tried in the table's tests, the leaders in fresh ones, and the leaders of both in
fresh ones again. `kept` are the wins of the last round, of what led before it.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
from scipy.stats import binomtest

from adaptsim_jax import default_comparison, make_one_shot
from adaptsim_jax.core import process
from adaptsim_jax.core.files import output_folder, write_json
from adaptsim_jax.tasks.one_shot import TargetWorld, action_grid
from adaptsim_jax.tasks.scooping.one_shot import GRID
from adaptsim_jax.tasks.scooping.task import SETTINGS
from adaptsim_jax.tasks.scooping.trial import success, test_contexts

# Leaders that are tried (None: all), and in how many tests that nothing was tried in before.
ROUNDS = ((None, 6), (48, 24), (8, 96))
PART = 24  # actions that are simulated at once


def wins(
    world: TargetWorld, params: np.ndarray, actions: np.ndarray, tests: np.ndarray
) -> np.ndarray:
    """`[N, G]`: whether each of `actions [N, 3]` wins in each of `tests [G, 5]`."""
    done = []
    for at in range(0, len(actions), PART):
        some = actions[at : at + PART]
        pairs = np.repeat(some, len(tests), 0), np.tile(tests, (len(some), 1))
        outcomes, _ = world.run(np.tile(params, (len(pairs[0]), 1)), pairs[1], pairs[0])
        done.append(np.asarray(success(outcomes)).reshape(len(some), -1))
    return np.concatenate(done)


def halved(world: TargetWorld, params: np.ndarray, actions: np.ndarray) -> list[dict]:
    """Each round's actions, the tests that they won `[N]` of how many, and the share before it."""
    share, first, rounds = np.zeros(len(actions)), 0, []
    spent = np.zeros((len(actions), 2))  # wins, tests
    for most, count in ROUNDS:
        lead = np.argsort(-share, kind="stable")[:most]
        won = wins(world, params, actions[lead], test_contexts(first + count)[first:]).sum(1)
        rounds.append(
            {
                "actions": actions[lead].tolist(),
                "won": won.tolist(),
                "of": count,
                "before": share[lead].tolist(),
            }
        )
        spent[lead] += np.stack([won, np.full(len(lead), count)], 1)
        first += count
        behind = np.setdiff1d(np.arange(len(actions)), lead)
        share = spent[:, 0] / spent[:, 1]
        share[behind] = -1.0
    return rounds


def told(rounds: list[dict]) -> dict[str, float | list[float]]:
    """Shares of wins: of all actions; the most of any, on the table's tests; and on the last
    round's tests, of the action that led before it with its 95 % interval, of all leaders, and of
    the best of them.
    """
    first, last = rounds[0], rounds[-1]
    lead = int(np.argmax(last["before"]))
    interval = binomtest(int(last["won"][lead]), last["of"]).proportion_ci(method="wilson")
    return {
        "all": float(np.mean(first["won"]) / first["of"]),
        "most": float(max(first["won"]) / first["of"]),
        "kept": float(last["won"][lead] / last["of"]),
        "interval": [float(interval.low), float(interval.high)],
        "leaders": float(np.mean(last["won"]) / last["of"]),
        "best leader": float(max(last["won"]) / last["of"]),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", required=True)
    parser.add_argument("--target", default="hydro", help="engine; default hydro, ours")
    parser.add_argument("--settings", nargs="+", default=list(SETTINGS), choices=SETTINGS)
    args = parser.parse_args()
    process.enable_cache()
    out = output_folder(Path(args.out))
    world = make_one_shot("scooping", dict(default_comparison("scooping").train.task)).world(
        args.target
    )
    actions = action_grid(GRID).astype(np.float32)
    for name in args.settings:
        begin = time.process_time()
        rounds = halved(world, np.array(list(SETTINGS[name].values()), np.float32), actions)
        answer = told(rounds) | {"cpu": time.process_time() - begin}
        write_json(out / f"ceiling-{args.target}-{name}.json", answer | {"rounds": rounds})
        row = "  ".join(f"{k} {np.round(v, 3)}" for k, v in answer.items())
        print(f"{args.target} {name}: {row}", flush=True)


if __name__ == "__main__":
    main()
