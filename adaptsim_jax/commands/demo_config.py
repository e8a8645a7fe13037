"""Sizes of the tour of `adaptsim demo`, and what a person types for the same, a step at a time."""

from __future__ import annotations

import math
import shlex
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from adaptsim_jax.adaptation.phase1 import Phase1Config
from adaptsim_jax.adaptation.training import TrainConfig, default_config
from adaptsim_jax.baselines.config import default_comparison
from adaptsim_jax.baselines.sysid import SysIdConfig
from adaptsim_jax.core import config as configs
from adaptsim_jax.core.config import Table

TASK, TARGET = "pendulum", "ood-1"
HINGE = Path(__file__).parents[1] / "attribution" / "sample" / "recording"
PENDULUM = Path(__file__).parents[1] / "logs" / "sample" / "recording"


@dataclass(frozen=True)
class ContactConfig:
    """Sizes of the push or the scoop: the target, Phase 1's trajectories, how many at once and
    updates a round, starts N and iterations. options: Of the task, over its default ones.
    """

    target: str
    trajectories: int
    parallel: int
    updates: int
    starts: int = 2
    iterations: int = 8
    options: Table = field(default_factory=dict)

    def train(self, task: str, seed: int) -> TrainConfig:
        """Phase 1 of `task` at these sizes; all else is the task's own default."""
        base = default_config(task)
        sizes = {
            "trajectories": self.trajectories,
            "parallel": self.parallel,
            "updates": self.updates,
        }
        options = configs.over(base.task, self.options)
        reuse = replace(
            base.phase1.reuse, together=math.gcd(base.phase1.reuse.together, self.parallel)
        )
        return replace(
            base, seed=seed, task=options, phase1=replace(base.phase1, reuse=reuse, **sizes)
        )


@dataclass(frozen=True)
class DemoConfig:
    """Sizes of the tour: of the pendulum seeds of every method, N, iterations, Phase 1 and SysID's
    budgets, and which baselines; of the push and the scoop. Whether they are filmed, and whether
    the double pendulum's sample is diagnosed beside the hinge's.
    """

    seeds: int = 1
    starts: int = 2
    iterations: int = 10
    train: TrainConfig = TrainConfig(phase1=Phase1Config(trajectories=2_000))  # noqa: RUF009
    sysid: SysIdConfig = SysIdConfig()  # noqa: RUF009
    baselines: tuple[str, ...] = ("sysid_point", "udr", "best_in_omega")
    push: ContactConfig = field(
        default_factory=lambda: ContactConfig(
            "ood-2",
            500,
            250,
            1200,
            iterations=5,
            options={"shared": {"contexts": 500, "trials": 128, "updates": 2000}},
        )
    )
    scoop: ContactConfig = field(
        default_factory=lambda: ContactConfig("wd", 50, 50, 240, iterations=4)
    )
    films: bool = False
    double: bool = False


SHORT = DemoConfig()
FULL = DemoConfig(
    seeds=3,
    train=TrainConfig(phase1=Phase1Config(trajectories=4_000)),
    baselines=("sysid_bayes", "sysid_point", "udr", "best_in_omega"),
    push=ContactConfig("ood-2", 5000, 250, 2400),
    scoop=ContactConfig("wd", 1250, 50, 480),
    films=True,
    double=True,
)


def commands(out: Path, seed: int, config: DemoConfig) -> dict[str, str]:
    """What a person types for the same, into folders beside the tour's own.

    One difference: `compare` draws other starts from S_E than `adapt`, so its row of AdaptSim is
    near the tour's and not the same.
    """

    def again(name):
        return shlex.quote(str(out / "again" / name))

    sizes = {"starts": config.starts, "iterations": config.iterations}
    asked = replace(default_comparison(TASK), train=config.train, sysid=config.sysid, **sizes)
    methods = ",".join(name.replace("_", "-") for name in ("adaptsim", *config.baselines))
    trained = _changes(config.train, default_config(TASK), "seed")
    compared = _changes(asked, default_comparison(TASK))
    lines = {
        "train": f"adaptsim train {TASK} --run {again('run')} --seed {seed}{trained}",
        "adapt": f"adaptsim adapt {again('run')} --target {TARGET} --seed {seed} "
        f"--starts {config.starts} --iterations {config.iterations}",
        "compare": f"adaptsim compare {TASK} --out {again('comparison')} --seed {seed} --seeds "
        f"{config.seeds} --settings {TARGET} "
        f"--methods {methods}{compared}",
        "diagnose": f"adaptsim diagnose {shlex.quote(str(HINGE))} --out {again('diagnosis')} "
        f"--seed {seed}",
        "double": f"adaptsim diagnose {shlex.quote(str(PENDULUM))} --out {again('double')} --seed "
        f"{seed}",
    }
    for task, sized in (("pushing", config.push), ("scooping", config.scoop)):
        changed = _changes(sized.train(task, seed), default_config(task), "seed")
        lines[f"train_{task}"] = f"adaptsim train {task} --run {again(task)} --seed {seed}{changed}"
        lines[f"adapt_{task}"] = (
            f"adaptsim adapt {again(task)} --target {sized.target} --seed {seed} --starts "
            f"{sized.starts} --iterations {sized.iterations} --video"
        )
    return lines


def _changes(config: Any, default: Any, *but: str) -> str:
    """` --set key=value` for each key, `but` some, in which `config` is not as `default`."""
    before, after = (configs.flatten(configs.to_table(one)) for one in (default, config))
    changed = [key for key in after if key not in but and after[key] != before.get(key)]
    texts = [
        f"{key}={configs.dumps({'v': after[key]}).removeprefix('v = ').strip()}" for key in changed
    ]
    return "".join(f" --set {shlex.quote(text)}" for text in texts)
