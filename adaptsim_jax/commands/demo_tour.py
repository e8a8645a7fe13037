"""The tour of `adaptsim demo`: a pendulum adapted beside baselines, a push and a scoop before and
after, a recording diagnosed, one page.

Small sizes of the real thing: nothing here computes what the other commands do not. A tour that was
stopped is taken up again by the same call, from the checkpoints of its runs.
"""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.adaptation.phase2 import Phase2Result, best_visit
from adaptsim_jax.adaptation.training import TrainConfig, Trained, adapt_run, train_run
from adaptsim_jax.baselines.arena import Visits
from adaptsim_jax.baselines.bounds import RewardMap, pendulum_problem, reward_map
from adaptsim_jax.baselines.compare import compare
from adaptsim_jax.baselines.compare_exact import ExactArena, find_bounds, visiting_rows
from adaptsim_jax.baselines.config import CompareConfig
from adaptsim_jax.commands.adapt import describe
from adaptsim_jax.commands.demo_config import (
    FULL,
    HINGE,
    PENDULUM,
    SHORT,
    TARGET,
    TASK,
    ContactConfig,
    DemoConfig,
    commands,
)
from adaptsim_jax.commands.diagnose import diagnose
from adaptsim_jax.commands.phase2 import phase2
from adaptsim_jax.core import config as configs
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.files import output_folder, write_json
from adaptsim_jax.core.parallel import worker_process
from adaptsim_jax.core.progress import Parts, Report, silent_parts
from adaptsim_jax.core.store import CONFIG, RunFolder
from adaptsim_jax.report.film import write_film
from adaptsim_jax.tasks.registry import TASKS

# ---------------------------------------------------------------- parts
#
# Parts of the tour: the pendulum beside baselines with a map of what could be earned, and the push
# and the scoop, each with what the first and the last policy do there.

MAP_LIMITS = ((0.8, 2.2), (0.2, 2.2))  # kg, m1 and m2: Omega and the target, which is outside it


class Adapted(NamedTuple):
    """One Phase 1 run and what Phase 2 made of it in the target."""

    folder: RunFolder
    trained: Trained
    result: Phase2Result


class Pendulum(NamedTuple):
    """adapted: a run a seed. results: The comparison, as results.json. reward_map: Around the
    target.
    """

    adapted: list[Adapted]
    results: Table
    reward_map: RewardMap


def pendulum_part(
    out: Path, seed: int, config: DemoConfig, report_of: Callable[[str], Report]
) -> Pendulum:
    """Everything that the tour shows of the pendulum; runs and the comparison lie in `out`."""
    adapted = [
        _adapt(out, replace(config.train, seed=seed + i), config, i, report_of("pendulum"))
        for i in range(config.seeds)
    ]
    return Pendulum(adapted, *_compare(out, adapted, seed, config, report_of("baselines")))


def run_folder(path: Path, train: TrainConfig, task: str) -> RunFolder:
    """A new run folder, or the one that is there; a kill may have left a folder and nothing in
    it.
    """
    if (path / CONFIG).exists():
        start = RunFolder.resume
    else:
        start = RunFolder.create
    return start(path, configs.to_table(train), task=task)


def _adapt(
    out: Path, train: TrainConfig, config: DemoConfig, index: int, report: Report
) -> Adapted:
    """Phase 1 into a run folder (or from one), and Phase 2 in the target."""
    report(index, config.seeds)
    folder = run_folder(out / "runs" / f"seed-{train.seed}", train, TASK)

    def share(done, total, note=""):
        return report(index + 0.9 * done / total, config.seeds, note)

    trained = train_run(train, folder, share)
    task = trained.phase1.task
    target = task.space.values(task.settings[TARGET], TARGET)
    sizes = {"starts": config.starts, "iterations": config.iterations}
    result = adapt_run(trained, jax.random.key(train.seed), target, **sizes)
    report(index + 1, config.seeds, f"reward in the target {float(result.reward):.2f} of 1")
    return Adapted(folder, trained, result)


def _compare(out: Path, adapted: list[Adapted], seed: int, config: DemoConfig, report: Report):
    """AdaptSim's row from the runs, the baselines' rows, and the map of rewards around the
    target.
    """
    sizes = {
        "seeds": config.seeds,
        "starts": config.starts,
        "iterations": config.iterations,
        "sysid": config.sysid,
    }
    report(0, 1)
    full = ["--full"] if config == FULL else []
    command = shlex.join(["adaptsim", "demo", *full, "--out", str(out), "--seed", str(seed)])

    def share(done, total, note=""):
        return report(0.8 * done / total, 1, note)

    results = compare(
        TASK, CompareConfig(config.baselines, (TARGET,), seed=seed, **sizes), share, command
    )
    report(0.8, 1, "map of rewards")
    task = adapted[0].trained.phase1.task
    problem = pendulum_problem(task.space)
    targets = np.array([task.space.values(task.settings[TARGET], TARGET)])
    arena, bounds = ExactArena(TASK, {}, problem, targets), find_bounds(problem, targets)
    means = np.stack([np.asarray(one.result.history.mean) for one in adapted])[None]
    visits = Visits(means, config.starts * (config.iterations + 1))
    results["rows"] = visiting_rows("adaptsim", [TARGET], arena, bounds, visits) + results["rows"]
    write_json(output_folder(out / "comparison") / "results.json", results)
    ends = float(bounds.lower[0]), float(bounds.upper[0])
    chart = reward_map(problem, targets[0], ends, names=("m1", "m2"), limits=MAP_LIMITS)
    report(1, 1)
    return results, chart


class Before(NamedTuple):
    """What adaptation changed.

    learned: Trajectories of Phase 1. found: As `result.json` of `adaptsim adapt` has it. start: The
        one whose best visit is deployed.
    trials: Made in the target in all. before, after: Rewards, by the task's tests, of that start's
        first and of the deployed policy.
    figure: Of both policies. ends: How their trials ended, in words. film: Its path, where there
        is one.
    """

    learned: int
    found: Table
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
    adapt = kind.adapt
    assert adapt is not None and adapt.before_after is not None  # of both tasks of `ContactConfig`
    look = adapt.before_after(made, both, np.asarray(target))
    if film:
        path = write_film(adapt.scene(), look.clips(), out / name)[0]
    else:
        path = None
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


class DemoResult(NamedTuple):
    """What the tour found: adapted pendulum runs, their comparison (as results.json) and reward
    map, the push, the scoop, the diagnosis, where it was asked for the report on the second sample,
    and what to type for the same.
    """

    adapted: list[Adapted]
    results: Table
    reward_map: Any
    push: Before
    scoop: Before
    diagnosis: Table
    double: Table | None
    commands: dict[str, str]


def demo(
    out: str | Path,
    seed: int = 0,
    progress: Parts = silent_parts,
    config: DemoConfig = SHORT,
    two_processes: bool = False,
) -> DemoResult:
    """Run the tour into the folder `out`; returns what it found after writing `out/index.html`.

    two_processes: whether the push and the scoop run in a process beside this one, for two cores.
    Raises BadInput where `out` cannot be written or holds runs of other sizes.
    """
    from adaptsim_jax.report.demo_page import write_demo

    out = output_folder(out)
    if two_processes:
        with worker_process(contact_parts, out, seed, config, report=progress) as other:
            first = own_parts(out, seed, config, progress)
            push, scoop = other.result()
    else:
        first = own_parts(out, seed, config, progress)
        push, scoop = contact_parts(out, seed, config, progress)
    pendulum, diagnosis, double = first
    progress("page", 0, 1)
    tour = DemoResult(*pendulum, push, scoop, diagnosis, double, commands(out, seed, config))
    write_demo(tour, out)
    progress("page", 1, 1)
    return tour


def own_parts(
    out: Path, seed: int, config: DemoConfig, progress: Parts
) -> tuple[Pendulum, Table, Any]:
    """The pendulum and what is diagnosed."""
    report_of = _named(progress)
    pendulum = pendulum_part(out, seed, config, report_of)
    hinge = diagnosed(HINGE, out / "diagnosis", report_of("diagnosis"))
    return (
        pendulum,
        hinge,
        diagnosed(PENDULUM, out / "double", report_of("double")) if config.double else None,
    )


def diagnosed(data: Path, out: Path, report: Report) -> Table:
    """Diagnose a sample into the folder `out`; the report, as report.json."""
    report(0, 1, "reading")
    found = diagnose(data, out=output_folder(out), progress=report)
    report(1, 1, f"verdict: {found['verdict'].replace('_', ' ')}")
    return found


def contact_parts(
    out: Path, seed: int, config: DemoConfig, progress: Parts
) -> tuple[Before, Before]:
    """The push and the scoop."""
    report_of = _named(progress)
    push = contact_part(out, "push", "pushing", seed, config.push, config.films, report_of("push"))
    scoop = contact_part(
        out, "scoop", "scooping", seed, config.scoop, config.films, report_of("scoop")
    )
    return push, scoop


def _named(progress: Parts) -> Callable[[str], Report]:
    def part(name: str) -> Report:
        return lambda done, total, note="": progress(name, done, total, note)

    return part
