"""The tour's push and scoop: a small Phase 1, Phase 2 in a target, and what the first and the last
policy do there.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
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
from adaptsim_jax.commands.task_parts import adapt_part
from adaptsim_jax.core import config as configs
from adaptsim_jax.core.files import output_folder, write_json
from adaptsim_jax.core.progress import Report
from adaptsim_jax.tasks.registry import TASKS


class Before(NamedTuple):
    """What adaptation changed.

    learned: trajectories of Phase 1. found: as `result.json` of `adaptsim adapt` has it. start: the
        one whose best visit is deployed.
    trials: made in the target in all. before, after: rewards, by the task's tests, of that start's
        first and of the deployed policy.
    shown: of both policies, what is drawn (`Pushes`, or two `ScoopClip`s). film: its path, where
        there is one.
    """

    learned: int
    found: dict[str, Any]
    start: int
    trials: int
    before: float
    after: float
    shown: Any
    film: Path | None = None


class Pushes(NamedTuple):
    """goals `[G, 2]` m; of the policy before and after: tracks `[2, G, T, 2]` m and rewards `[2,
    G]`; patch: its place across, m.
    """

    goals: np.ndarray
    tracks: np.ndarray
    rewards: np.ndarray
    patch: float


def push_part(out: Path, seed: int, sizes: ContactConfig, film: bool, report: Report) -> Before:
    """The push from above, before and after."""
    from adaptsim_jax.commands.adapt_pushing import filmed, pushes_of

    def show(made, both, target):
        goals, actions, tracks, rewards = pushes_of(made, both, target)
        each = [(g, i, who) for g in range(len(goals)) for i, who in enumerate(("before", "after"))]
        takes = [(f"{who} adaptation", actions[i, g], goals[g]) for g, i, who in each]
        path = filmed(made, target, takes, out / "push")[0] if film else None
        return Pushes(goals, tracks, rewards, float(target[3])), path

    return _contact(out, "push", "pushing", seed, sizes, show, report)


def scoop_part(out: Path, seed: int, sizes: ContactConfig, film: bool, report: Report) -> Before:
    """The scoop from the side, before and after."""
    from adaptsim_jax.commands.adapt_scooping import clips_of

    def show(made, both, target):
        clips = clips_of(made, both, target)
        path = None
        if film:
            from adaptsim_jax.report.scoop_video import write_scoop_video

            path = write_scoop_video(clips, out / "scoop")[0]
        return clips, path

    return _contact(out, "scoop", "scooping", seed, sizes, show, report)


def _contact(
    out: Path,
    name: str,
    task_name: str,
    seed: int,
    sizes: ContactConfig,
    show: Callable[..., Any],
    report: Report,
) -> Before:
    """Phase 1 into `out/runs/NAME` (or from there), Phase 2, and `show(options, both policies,
    target)`.
    """
    report(0, 1, "learning in simulation")
    train = sizes.train(task_name, seed)
    folder = run_folder(out / "runs" / name, train, task_name)
    trained = train_run(
        train, folder, lambda done, total, note="": report(0.7 * done / total, 1, note)
    )
    task = trained.phase1.task
    target = task.space.values(task.settings[sizes.target], sizes.target)
    report(0.7, 1, "adapting to the target")
    part = adapt_part(task_name)
    result = part.adapt(
        trained, folder.config["task"], jax.random.key(seed), target, sizes.starts, sizes.iterations
    )
    here = argparse.Namespace(folder=str(folder.path), seed=seed)
    found = describe(result, task, sizes.target, target, here)
    write_json(output_folder(out / name) / "result.json", found)
    report(0.9, 1, "looking at both policies")
    start = int(best_visit(result.history.score)[0])
    both = jax.tree.map(
        lambda a, b: jnp.stack([a[start, 0], b]), result.history.policy, result.policy
    )
    made = configs.from_table(TASKS[task_name].config, folder.config["task"], str(folder.path))
    shown, film = show(made, both, np.asarray(target))
    before, after = float(result.history.reward[start, 0]), float(result.reward)
    report(1, 1, f"reward {before:.2f} before, {after:.2f} after")
    return Before(
        sizes.trajectories,
        found,
        start,
        found["trials"] * made.trajectories,
        before,
        after,
        shown,
        film,
    )
