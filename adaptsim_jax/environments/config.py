"""What an environment's task is made of: `env.toml`, and the options of a run."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from adaptsim_jax.core import config as configs
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.environments.planner import PlannerConfig
from adaptsim_jax.environments.trainer import PPOTraining

OF_RUN = ("phase1", "hyper", "seed", "every")
"""Tables of an env.toml that are of the run, not of the task."""


@dataclass(frozen=True)
class EnvironmentConfig:
    """Options of the task.

    env: `cartpole`, `arm`, `playground:NAME`, `brax:NAME`, `gymnax:NAME`, `module:function`,
        `file.py:function`; options: given to it.
    fields: Omega, a range `[low, high]` or `[low, high, "log"]` for each number by name
        (docs/howto/environment.md).
    wide: how far beyond Omega, as a share of each range, Phase 1 draws its targets. trials:
        episodes of a visit, each counted.
    length: steps of an episode, 0 for the environment's own.
    policy: `knows` E's mean, trained once; `tuned` from it at each visit for `tune` updates;
        `planned` by sampling, not trained.
    spread: of E's samples when a policy is tuned, as a share of each range. training: PPO. planner:
        of `planned`.
    references: policies that a target's reward is scaled with. components: of what is observed.
    doubt: variance of a visit's return by luck, over that by E's mean; 0 deploys what returned most
        once.
    targets: for each by name a table of values of any field, Omega's or not, and of the engine
        (`environments/targets.py`).
    """

    env: str = "cartpole"
    options: dict[str, Any] = field(default_factory=dict)
    fields: dict[str, Any] = field(default_factory=dict)
    wide: float = 0.3
    trials: int = 1
    length: int = 0
    policy: Literal["knows", "tuned", "planned"] = "knows"
    tune: int = 4
    spread: float = 0.05
    training: PPOTraining = field(default_factory=PPOTraining)
    planner: PlannerConfig = field(default_factory=PlannerConfig)
    references: int = 8
    components: int = 12
    doubt: float = 0.3
    targets: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self):
        for name in ("trials", "tune", "references", "components"):
            if getattr(self, name) < 1:
                raise BadInput(f"{name} = {getattr(self, name)}: give at least 1")
        for name in ("wide", "length", "spread", "doubt"):
            if getattr(self, name) < 0:
                raise BadInput(f"{name} = {getattr(self, name)}: give 0 or more")


def read_env(path: str | Path) -> dict[str, Any]:
    """An env.toml as the table of a run: the task's options under `task`, `phase1`, `hyper`,
    `seed`, `every` beside them.

    A file of Python that `env` names is found from the folder of env.toml. BadInput names the key
    at fault.
    """
    table = configs.read(path)
    options = {key: value for key, value in table.items() if key not in OF_RUN}
    home, colon, thing = str(options.get("env", "")).rpartition(":")
    if colon and home.endswith(".py"):
        options["env"] = f"{(Path(path).parent / home).resolve()}:{thing}"
    configs.from_table(EnvironmentConfig, options, str(path))
    return {key: table[key] for key in OF_RUN if key in table} | {"task": options}
