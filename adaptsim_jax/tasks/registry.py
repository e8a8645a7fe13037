"""Tasks by name, made from a table of options as a config file holds it. Imports no JAX: commands
list the names.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from adaptsim_jax.core import config
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.registry import Registry

if TYPE_CHECKING:
    from adaptsim_jax.tasks.base import Task, TaskKind
    from adaptsim_jax.tasks.engine import Backend
    from adaptsim_jax.tasks.one_shot import OneShot
    from adaptsim_jax.tasks.trial_diagnosis import Diagnose

TASKS: Registry[TaskKind] = Registry(
    "tasks",
    {
        "pendulum": "adaptsim_jax.tasks.pendulum.kind:TASK",
        "pushing": "adaptsim_jax.tasks.pushing.kind:TASK",
        "scooping": "adaptsim_jax.tasks.scooping.kind:TASK",
        "environment": "adaptsim_jax.environments.kind:TASK",
    },
    type="TaskKind",
)

TRIALS: Registry[Diagnose] = Registry(
    "trials",
    {
        "pushing": "adaptsim_jax.tasks.pushing.diagnosis.diagnose:diagnose",
        "scooping": "adaptsim_jax.tasks.scooping.diagnosis.diagnose:diagnose",
        "toss": "adaptsim_jax.tasks.toss.diagnose:diagnose",
    },
    type="Diagnose",
)
"""Tasks of short trials that a camera saw, and how they are read and diagnosed."""


def make_task(name: str, options: Mapping[str, Any], where: str = "config, [task]") -> Task:
    """The task called `name`. BadInput names an unknown task or option, with the nearest known
    one.
    """
    kind = TASKS[config.pick("task", name, TASKS)]
    return kind.make(config.from_table(kind.config, dict(options), where))


def make_one_shot(name: str, options: Mapping[str, Any], where: str = "config, [task]") -> OneShot:
    """The task called `name` as the baselines see tasks of one decision a trial. BadInput as
    `make_task`.
    """
    kind = TASKS[config.pick("task", name, TASKS)]
    if kind.one_shot is None:
        raise BadInput(
            f"task '{name}' cannot be compared yet: it gives no `one_shot` (tasks/one_shot.py)"
        )
    return kind.one_shot(config.from_table(kind.config, dict(options), where))


def make_backend(task: str, name: str, /, *options: Any, **settings: Any) -> Backend:
    """The engine called `name` of `task`, as `simulate(params [B, P], commands [B, ...], initial
    [B, ...]) -> Trajectory`.

    What the arrays hold, in SI units, stands in `tasks/TASK/engines`. options: The step
    [s] for the pendulum, `PushOptions`, `ScoopOptions`. settings: The engine's own. BadInput where
    the name is unknown, or the engine absent or unable.
    """
    kind = TASKS[config.pick("task", task, TASKS)]
    if not kind.backends:
        raise BadInput(f"task '{task}' has no engines beside its own simulator; use `make_task`")
    return kind.backends.make(name, *options, **settings)
