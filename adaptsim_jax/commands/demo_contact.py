"""The tour's push and scoop: a small Phase 1, Phase 2 in a target, and what the first and the last
policy do there.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.adaptation.phase2 import best_visit
from adaptsim_jax.adaptation.training import train_run
from adaptsim_jax.commands.adapt import describe
from adaptsim_jax.commands.demo_config import ContactConfig
from adaptsim_jax.commands.demo_pendulum import run_folder
from adaptsim_jax.commands.phase2 import phase2
from adaptsim_jax.core import config as configs
from adaptsim_jax.core.files import output_folder, write_json
from adaptsim_jax.core.progress import Report
from adaptsim_jax.report.film import write_film
from adaptsim_jax.tasks.registry import TASKS


class Before(NamedTuple):
    """What adaptation changed.

    learned: trajectories of Phase 1. found: as `result.json` of `adaptsim adapt` has it. start: the
        one whose best visit is deployed.
    trials: made in the target in all. before, after: rewards, by the task's tests, of that start's
        first and of the deployed policy.
    figure: of both policies; ends: how their trials ended, in words; film: its path, where there
        is one.
    """

    learned: int
    found: dict[str, Any]
    start: int
    trials: int
    before: float
    after: float
    figure: Any
    ends: tuple[str, ...] = ()
    film: Path | None = None


def contact_part(
    out: Path,
    name: str,
    task_name: str,
    seed: int,
    sizes: ContactConfig,
    film: bool,
    report: Report,
) -> Before:
    """Phase 1 into `out/runs/NAME` (or from there), Phase 2, and both policies looked at."""
    report(0, 1, "learning in simulation")
    train = sizes.train(task_name, seed)
    folder = run_folder(out / "runs" / name, train, task_name)

    def learning(done, total, note=""):
        report(0.7 * done / total, 1, note)

    trained = train_run(train, folder, learning)
    task, options = trained.phase1.task, folder.config["task"]
    target = task.space.values(task.settings[sizes.target], sizes.target)
    report(0.7, 1, "adapting to the target")
    key = jax.random.key(seed)
    result = phase2(task_name, trained, options, key, target, sizes.starts, sizes.iterations)
    here = argparse.Namespace(folder=str(folder.path), seed=seed)
    found = describe(result, task, sizes.target, target, here)
    write_json(output_folder(out / name) / "result.json", found)
    report(0.9, 1, "looking at both policies")
    start = int(best_visit(result.history.score)[0])
    both = jax.tree.map(
        lambda a, b: jnp.stack([a[start, 0], b]), result.history.policy, result.policy
    )
    kind = TASKS[task_name]
    made = configs.from_table(kind.config, options, str(folder.path))
    look = kind.adapt.before_after(made, both, np.asarray(target))
    path = write_film(kind.adapt.scene(), look.clips(), out / name)[0] if film else None
    before, after = float(result.history.reward[start, 0]), float(result.reward)
    report(1, 1, f"reward {before:.2f} before, {after:.2f} after")
    return Before(
        sizes.trajectories,
        found,
        start,
        found["trials"] * made.trajectories,
        before,
        after,
        look.figure,
        look.ends,
        path,
    )
