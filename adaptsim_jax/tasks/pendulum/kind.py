"""The pendulum's task as the registry holds it."""

from collections.abc import Mapping
from typing import Any

from adaptsim_jax.core.errors import BadInput, brief, finite
from adaptsim_jax.mend.pendulum_model import model_of
from adaptsim_jax.tasks.base import Task, TaskKind
from adaptsim_jax.tasks.pendulum.augmented import make_mended_pendulum
from adaptsim_jax.tasks.pendulum.engines import BACKENDS, PARITY
from adaptsim_jax.tasks.pendulum.robot import ROBOT
from adaptsim_jax.tasks.pendulum.task import PendulumConfig, make_pendulum


def augmented(options: dict[str, Any], where: str) -> Task:
    """The task on a mended model, whose table stands under `model`; `reward_gain` may stand beside
    it.
    """
    given, reward_gain = options.pop("model"), options.pop("reward_gain", 10.0)
    if options:
        raise BadInput(
            f"{where}: unknown key '{next(iter(options))}'; with a mended model there is: "
            "reward_gain"
        )
    if not isinstance(given, Mapping) or given.get("task") != "pendulum":
        raise BadInput(
            f"{where}: 'model' is no mended model of task 'pendulum'; use `adaptsim train pendulum "
            "--model FILE`"
        )
    gain = finite(reward_gain)
    if gain is None or gain <= 0:
        raise BadInput(
            f"{where}: reward_gain = {brief(reward_gain)} must be a positive number; leave it out "
            "for 10"
        )
    return make_mended_pendulum(model_of(given, f"{where}, model"), gain)


def of_model(table: dict[str, Any], where: str) -> dict[str, Any]:
    """The option `model`: the checked file, less what is only for people."""
    model_of(table, where)
    return {
        "model": {
            key: value for key, value in table.items() if key not in ("covariance", "provenance")
        }
    }


TASK = TaskKind(
    PendulumConfig,
    make_pendulum,
    augmented=augmented,
    of_model=of_model,
    robot=ROBOT,
    backends=BACKENDS,
    parity=PARITY,
)
