"""Tasks by name, made from a table of options as a config file holds it."""

from collections.abc import Mapping
from typing import Any

from adaptsim_jax import config
from adaptsim_jax.tasks.base import Task
from adaptsim_jax.tasks.pendulum import PendulumConfig, make_pendulum

TASKS = {"pendulum": (PendulumConfig, make_pendulum)}


def make_task(name: str, options: Mapping[str, Any], where: str = "config, [task]") -> Task:
    """The task called `name`; BadInput names an unknown task or option, with the nearest known one."""
    kind, make = TASKS[config.pick("task", name, TASKS)]
    return make(config.from_table(kind, dict(options), where))
