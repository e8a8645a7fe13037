"""`adaptsim adapt`."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import Any

from adaptsim_jax.core.config import Table

EXAMPLES = """
  adaptsim adapt runs/a --target ood-1
  adaptsim adapt runs/a --target my_robot.toml     m1 = 1.4, m2 = 0.6, ... one line each
  adaptsim adapt runs/a --target out/model.toml    the mended model of `adaptsim diagnose` as the target
  adaptsim adapt runs/a --target wd --starts 4 --iterations 20
  adaptsim adapt runs/p --target ood-2 --video     a run of the push: figures, and a film of its first and best policy
  adaptsim adapt runs/s --target ood-1 --video     the same of scooping
  adaptsim adapt runs/e --target dry --video       a run of an env.toml: returns, and a film of its first and best policy
"""  # noqa: E501


def run(args: argparse.Namespace) -> int:
    """Phase 2 of a trained run: result.json, and a few lines for a person."""
    from adaptsim_jax.core.errors import BadInput
    from adaptsim_jax.core.store import RunFolder
    from adaptsim_jax.tasks.registry import TASKS

    folder = RunFolder.open(args.folder)
    kind = TASKS.named(folder.task, "task")
    if args.video and kind.adapt is None:
        raise BadInput(
            f"{args.folder}: there is no film of task '{folder.task}'; leave --video out"
        )
    import jax

    from adaptsim_jax.adaptation.training import load_run
    from adaptsim_jax.commands.parser import next_step, output, print_file, read_target
    from adaptsim_jax.commands.phase2 import phase2, write_look
    from adaptsim_jax.core.files import write_json

    trained = load_run(folder)
    task = trained.phase1.task
    name, params, world = read_target(args.target, task)
    if world is not None:
        task = world
        trained = trained._replace(phase1=trained.phase1._replace(task=task))
    with output(args.out or Path(args.folder) / f"adapt-{name}") as out:
        key, options = jax.random.key(args.seed), folder.config.get("task", {})
        result = phase2(folder.task, trained, options, key, params, args.starts, args.iterations)
        found = describe(result, task, name, params, args)
        write_json(out / "result.json", found)
    lines: list[str] = []
    if kind.adapt is not None:
        lines = write_look(folder, task, (name, params), result, out, args.video)
    if args.json:
        print_file(out / "result.json")
        return 0
    _show(found)
    print(f"written: {out / 'result.json'}")
    for line in lines:
        print(line)
    if kind.robot is not None:
        next_step(
            f"robot new {shlex.quote(str(args.folder))} --dir robot    the same with a real robot"
        )
    else:
        if folder.task == "environment":
            word, which = ("FILE.toml", ", FILE.toml the one that was trained")
        else:
            word, which = (folder.task, "")
        next_step(f"compare {word} --out compared    against other methods{which}")
    return 0


def describe(result: Any, task: Any, name: str, params: Any, args: argparse.Namespace) -> Table:
    """What Phase 2 found, as plain data: the best policy, where it came from, and every trial; None
    for what is not finite.
    """
    import numpy as np

    from adaptsim_jax.core.files import without_nan
    from adaptsim_jax.tasks.one_shot import leaves_by_name

    names = task.space.names
    physical = np.asarray(task.space.physical(result.history.mean))
    reward = np.asarray(result.history.reward)
    target = dict(zip(names, map(float, params), strict=True))
    history = [
        [
            {
                "reward": number(reward[s, i]),
                "params": dict(zip(names, physical[s, i].tolist(), strict=True)),
            }
            for i in range(reward.shape[1])
        ]
        for s in range(reward.shape[0])
    ]
    return {
        "schema": 1,
        "task": task.name,
        "run": str(args.folder),
        "seed": args.seed,
        "target": {"name": name, "params": target},
        "best": {
            "reward": number(result.reward),
            "score": number(result.score),
            "params": task.space.named(result.mean),
            "policy": without_nan(leaves_by_name(result.policy)),
        },
        "final": [number(row[-1]) for row in reward],
        "trials": int(reward.size),
        "history": history,
    }


def number(value: Any) -> float | None:
    """A float for JSON; None where it is not finite."""
    import math

    if math.isfinite(float(value)):
        return float(value)
    return None


def _show(found: Table) -> None:
    best = found["best"]
    print(
        f"target {found['target']['name']}: best reward {_digits(best['reward'])} of "
        f"{found['trials']} trials"
    )
    for start, visits in enumerate(found["history"], 1):
        print(f"  start {start}: reward {' '.join(_digits(visit['reward']) for visit in visits)}")
    rewards = [visit["reward"] for visits in found["history"] for visit in visits]
    if all(reward is None for reward in rewards):
        print("  no return is a number here: mend the reward, or what the target says")
    elif not any(rewards):
        print(
            "  no visit earned a reward: it tells no policies apart here; widen Omega, or reward "
            "what comes near"
        )
    for name, value in best["params"].items():
        print(f"  {name} {value:.4g} (target {found['target']['params'][name]:.4g})")


def _digits(value: float | None) -> str:
    if value is None:
        return "diverged"
    return f"{value:.3f}"
