"""The tour of `adaptsim demo`: train, adapt to OOD-1 beside the baselines, diagnose a sample recording, one page.

Small sizes of the real thing: nothing here computes what the other commands do not. A tour that was stopped is taken up
again by the same call, from the checkpoints of its runs.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from adaptsim_jax.adaptation.phase1 import Phase1Config
from adaptsim_jax.adaptation.phase2 import Phase2Result
from adaptsim_jax.adaptation.presets import default_config
from adaptsim_jax.adaptation.training import TrainConfig, Trained, adapt_run, train_run
from adaptsim_jax.baselines.compare import compare, find_bounds, visiting_rows
from adaptsim_jax.baselines.config import CompareConfig, default_comparison
from adaptsim_jax.baselines.methods import Visits
from adaptsim_jax.baselines.problem import pendulum_problem
from adaptsim_jax.baselines.reward_map import RewardMap, reward_map
from adaptsim_jax.baselines.sysid import SysIdConfig
from adaptsim_jax.commands.diagnose import diagnose
from adaptsim_jax.core import config as configs
from adaptsim_jax.core.files import output_folder, write_json
from adaptsim_jax.core.progress import Report, silent
from adaptsim_jax.core.store import CONFIG, RunFolder

TASK, TARGET = "pendulum", "ood-1"
BASELINES = ("sysid_bayes", "sysid_point", "udr", "best_in_omega")
SAMPLE = Path(__file__).parents[1] / "sysid" / "sample" / "recording"
MAP_LIMITS = ((0.8, 2.2), (0.2, 2.2))  # kg, m1 and m2: Omega and the target, which is outside it
STAGES = {"train": 0.3, "baselines": 0.25, "reward map": 0.05, "diagnose": 0.35, "page": 0.05}


@dataclass(frozen=True)
class DemoConfig:
    """Sizes of the tour: seeds of every method, N, iterations, Phase 1 and SysID's budgets. A fifth of a full Phase 1."""

    seeds: int = 3
    starts: int = 2
    iterations: int = 10
    train: TrainConfig = TrainConfig(phase1=Phase1Config(trajectories=4_000))  # noqa: RUF009
    sysid: SysIdConfig = SysIdConfig()  # noqa: RUF009


class Adapted(NamedTuple):
    """One Phase 1 run and what Phase 2 made of it in the target."""

    folder: RunFolder
    trained: Trained
    result: Phase2Result


class Tour(NamedTuple):
    """What the tour found: adapted runs, the comparison (as results.json), the reward map and the diagnosis's report."""

    adapted: list[Adapted]
    results: dict[str, Any]
    reward_map: RewardMap
    diagnosis: dict[str, Any]
    commands: dict[str, str]


def demo(out: str | Path, seed: int = 0, progress: Report = silent, config: DemoConfig = DemoConfig()) -> Tour:
    """Run the tour into the folder `out`; returns what it found after writing `out/index.html`.

    Raises BadInput where `out` cannot be written or holds runs of other sizes.
    """
    from adaptsim_jax.report.demo_page import write_demo

    out = output_folder(out)
    say = _stages(progress)
    adapted = [_adapt(out, replace(config.train, seed=seed + i), config, i, say) for i in range(config.seeds)]
    results, chart = _compare(out, adapted, seed, config, say)
    report = diagnose(SAMPLE, out=out / "diagnosis", seed=seed, progress=say("diagnose"))
    say("page")(0, 1)
    tour = Tour(adapted, results, chart, report, _commands(out, seed, config))
    write_demo(tour, out)
    say("page")(1, 1)
    return tour


def _stages(progress: Report) -> Callable[[str], Report]:
    """Reports of the stages as shares of one bar."""
    names = list(STAGES)

    def stage(name: str) -> Report:
        before = sum(STAGES[other] for other in names[: names.index(name)])

        def report(done: float, total: float, note: str = "") -> None:
            progress(before + STAGES[name] * done / max(total, 1e-9), 1.0, f"{name} {note}".strip())

        return report

    return stage


def _adapt(out: Path, train: TrainConfig, config: DemoConfig, index: int, say: Callable[[str], Report]) -> Adapted:
    """Phase 1 into a run folder (or from one), and Phase 2 in the target."""
    path = out / "runs" / f"seed-{train.seed}"
    start = (
        RunFolder.resume if (path / CONFIG).exists() else RunFolder.create
    )  # a kill may leave a folder and nothing in it
    folder = start(path, configs.to_table(train), task=TASK)
    report = say("train")
    trained = train_run(train, folder, lambda done, total, note="": report(index + done / total, config.seeds, note))
    task = trained.phase1.task
    target = task.space.values(task.settings[TARGET], TARGET)
    key, sizes = jax.random.key(train.seed), {"starts": config.starts, "iterations": config.iterations}
    return Adapted(folder, trained, adapt_run(trained, key, target, **sizes))


def _compare(out: Path, adapted: list[Adapted], seed: int, config: DemoConfig, say: Callable[[str], Report]):
    """AdaptSim's row from the runs, the baselines' rows, and the map of rewards around the target."""
    sizes = {"seeds": config.seeds, "starts": config.starts, "iterations": config.iterations, "sysid": config.sysid}
    say("baselines")(0, 1)
    command = shlex.join(["adaptsim", "demo", "--out", str(out), "--seed", str(seed)])
    results = compare(TASK, CompareConfig(BASELINES, (TARGET,), seed=seed, **sizes), say("baselines"), command)
    say("reward map")(0, 1)
    task = adapted[0].trained.phase1.task
    problem = pendulum_problem(task.space)
    targets = np.array([task.space.values(task.settings[TARGET], TARGET)])
    bounds = find_bounds(problem, targets)
    means = np.stack([np.asarray(one.result.history.mean) for one in adapted])[None]
    visits = Visits(means, config.starts * (config.iterations + 1))
    results["rows"] = visiting_rows("adaptsim", [TARGET], problem, targets, bounds, visits) + results["rows"]
    write_json(output_folder(out / "comparison") / "results.json", results)
    ends = float(bounds.lower[0]), float(bounds.upper[0])
    return results, reward_map(problem, targets[0], *ends, names=("m1", "m2"), limits=MAP_LIMITS)


def _commands(out: Path, seed: int, config: DemoConfig) -> dict[str, str]:
    """What a person types for the same, a step at a time, into folders beside the tour's own.

    One difference: `compare` draws other starts from S_E than `adapt`, so its row of AdaptSim is near the tour's and not the same.
    """
    run, comparison, diagnosis = (shlex.quote(str(out / "again" / name)) for name in ("run", "comparison", "diagnosis"))
    sizes = {"starts": config.starts, "iterations": config.iterations}
    asked = replace(default_comparison(TASK), train=config.train, sysid=config.sysid, **sizes)
    methods = ",".join(name.replace("_", "-") for name in ("adaptsim", *BASELINES))
    return {
        "train": f"adaptsim train {TASK} --run {run} --seed {seed}{_changes(config.train, default_config(TASK), 'seed')}",
        "adapt": f"adaptsim adapt {run} --target {TARGET} --seed {seed} --starts {config.starts} --iterations {config.iterations}",
        "compare": f"adaptsim compare {TASK} --out {comparison} --seed {seed} --seeds {config.seeds} --settings {TARGET} "
        f"--methods {methods}{_changes(asked, default_comparison(TASK))}",
        "diagnose": f"adaptsim diagnose {shlex.quote(str(SAMPLE))} --out {diagnosis} --seed {seed}",
    }


def _changes(config: Any, default: Any, *but: str) -> str:
    """` --set key=value` for each key, `but` some, in which `config` is not as `default`."""
    before, after = (configs.flatten(configs.to_table(one)) for one in (default, config))
    changed = [key for key in after if key not in but and after[key] != before.get(key)]
    texts = [f"{key}={configs.dumps({'v': after[key]}).removeprefix('v = ').strip()}" for key in changed]
    return "".join(f" --set {shlex.quote(text)}" for text in texts)
