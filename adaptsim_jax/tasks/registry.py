"""Tasks by name, made from a table of options as a config file holds it."""

from collections.abc import Mapping
from typing import Any

from adaptsim_jax.core import config
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.given import brief, finite
from adaptsim_jax.tasks.base import Task
from adaptsim_jax.tasks.one_shot import OneShot
from adaptsim_jax.tasks.pendulum.task import PendulumConfig, make_pendulum
from adaptsim_jax.tasks.pushing.one_shot import make_pushing_one_shot
from adaptsim_jax.tasks.pushing.task import PushingConfig, make_pushing
from adaptsim_jax.tasks.scooping.one_shot import make_scooping_one_shot
from adaptsim_jax.tasks.scooping.task import ScoopingConfig, make_scooping

TASKS = {
    "pendulum": (PendulumConfig, make_pendulum),
    "pushing": (PushingConfig, make_pushing),
    "scooping": (ScoopingConfig, make_scooping),
}
ONE_SHOTS = {"pushing": make_pushing_one_shot, "scooping": make_scooping_one_shot}


def _mended(name: str, options: dict[str, Any], where: str) -> Task:
    """The task on a mended model, whose table stands under `model`."""
    from adaptsim_jax.mechanisms.model_file import model_of
    from adaptsim_jax.tasks.pendulum.augmented import make_mended_pendulum

    given = options.pop("model")
    reward_gain = options.pop("reward_gain", 10.0)
    if options:
        raise BadInput(f"{where}: unknown key '{next(iter(options))}'; with a mended model there is: reward_gain")
    if not isinstance(given, Mapping) or given.get("task") != name:
        raise BadInput(
            f"{where}: 'model' is no mended model of task '{name}'; use `adaptsim train {name} --model FILE`"
        )
    gain = finite(reward_gain)
    if gain is None or gain <= 0:
        raise BadInput(f"{where}: reward_gain = {brief(reward_gain)} must be a positive number; leave it out for 10")
    return make_mended_pendulum(model_of(given, f"{where}, model"), gain)


def make_task(name: str, options: Mapping[str, Any], where: str = "config, [task]") -> Task:
    """The task called `name`, on a mended model where `options` hold one.

    BadInput names an unknown task or option, with the nearest known one.
    """
    kind, make = TASKS[config.pick("task", name, TASKS)]
    if "model" in options:
        if name != "pendulum":
            raise BadInput(f"{where}: a mended model of task '{name}' is not in this version yet; leave 'model' out")
        return _mended(name, dict(options), where)
    return make(config.from_table(kind, dict(options), where))


def make_one_shot(name: str, options: Mapping[str, Any], where: str = "config, [task]") -> OneShot:
    """The task called `name` as the baselines see tasks of one decision a trial. BadInput as `make_task`."""
    kind, _ = TASKS[config.pick("task", name, TASKS)]
    if name not in ONE_SHOTS:
        raise BadInput(f"task '{name}' cannot be compared yet; there is: pendulum, {', '.join(ONE_SHOTS)}")
    return ONE_SHOTS[name](config.from_table(kind, dict(options), where))
