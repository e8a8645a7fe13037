"""Configurations by name: `presets.toml`, and what `adaptsim train TASK` starts from."""

from dataclasses import fields
from pathlib import Path
from typing import Any

from adaptsim_jax.adaptation.training import TrainConfig
from adaptsim_jax.core import config as configs
from adaptsim_jax.tasks.registry import TASKS

FILE = Path(__file__).with_suffix(".toml")
PRESETS = (
    "paper-pendulum",
    "paper-pushing",
    "native-pushing",
    "mjx-pushing",
    "hydro-scooping",
    "mjx-scooping",
)
"""Those that --preset takes: the part behind the hyphen is the task."""


def presets_of(task: str) -> list[str]:
    """Those of one task."""
    return [name for name in PRESETS if name.endswith(f"-{task}")]


def preset(name: str) -> TrainConfig:
    """The configuration called `name` in `presets.toml`."""
    tables = configs.read(FILE)
    whole: dict[str, Any] = {}
    chain = [name]
    while base := tables[chain[-1]].get("base"):
        chain.append(base)
    for each in reversed(chain):
        table = {key: value for key, value in tables[each].items() if key != "base"}
        whole = configs.over(whole, table) | {"task": table.get("task", whole.get("task", {}))}
    return configs.from_table(TrainConfig, whole, f"preset '{name}'")


def default_config(task: str) -> TrainConfig:
    """What `adaptsim train TASK` starts from."""
    if task in ("pushing", "scooping"):
        return preset(task)
    if task not in TASKS:
        return TrainConfig()
    return configs.from_table(TrainConfig, dict(TASKS[task].train), f"task {task}, train")


def with_defaults(task: str, table: dict[str, Any]) -> dict[str, Any]:
    """`table` over the task's default config, key by key. A run's own config is whole and stays as
    it is.
    """
    if {f.name for f in fields(TrainConfig)} <= set(table):
        return table
    return configs.over(configs.to_table(default_config(task)), table)
