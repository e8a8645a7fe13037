"""An invented `results.json` of a sweep: run by nothing."""

import numpy as np

from adaptsim_jax.adaptation.sweep_folder import summary


def made(
    seeds=4,
    rounds=900,
    deltas=(0.1, 0.15, 0.2),
    choices=("paper", "<b>plain</b>"),
    targets=("wd", "ood-1"),
):
    """Members over two swept keys, one of numbers and one of words; member 3 failed, and one
    target's reward is missing.
    """
    rng, rows = np.random.default_rng(5), []
    for delta in deltas:
        for choice in choices:
            for seed in range(seeds):
                head = {
                    "member": len(rows),
                    "seed": seed,
                    "values": {"hyper.delta": delta, "task.scaling": choice},
                }
                if len(rows) == 3:
                    rows.append(head | {"status": "failed", "reason": "a loss <is> not finite"})
                    continue
                level = (
                    0.9
                    - 4 * (delta - 0.15) ** 2
                    - 0.1 * (choice != "paper")
                    + 0.03 * rng.standard_normal()
                )
                rise = level * (1 - np.exp(-np.arange(rounds) / 150)) + 0.04 * rng.standard_normal(
                    rounds
                )
                earned = {
                    t: {"reward": float(level - 0.05 * i + 0.05 * rng.standard_normal())}
                    for i, t in enumerate(targets)
                }
                if len(rows) == 5 and targets:
                    earned[targets[0]] = {"reward": None}
                done = {
                    "status": "done",
                    "reason": "",
                    "train_reward": float(rise[-90:].mean()),
                    "targets": earned,
                }
                rows.append(head | done | {"curve": rise.tolist()})
    swept = ["hyper.delta", "task.scaling"]
    return {
        "schema": 1,
        "version": "0",
        "spec": {"task": "pendulum", "targets": list(targets)},
        "swept": swept,
        "members": len(rows) + 2,
        "done": len(rows) - 1,
        "failed": 1,
        "rows": rows,
        "summary": summary(rows, swept, list(targets)),
    }
