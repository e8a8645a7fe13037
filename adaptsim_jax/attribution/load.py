"""From a recording and a model file to what is identified."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from adaptsim_jax.attribution import model_toml
from adaptsim_jax.attribution.choice import base_moves
from adaptsim_jax.attribution.machine import Machine, machine
from adaptsim_jax.attribution.pendulum import pendulum_machine
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.declared import declared_task
from adaptsim_jax.logs.pendulum import read_pendulum
from adaptsim_jax.logs.pool import Data, logs_of
from adaptsim_jax.logs.quality.audit import audit, usable
from adaptsim_jax.logs.read import joined, read_source_and_log
from adaptsim_jax.mend.model_toml import read_model_table
from adaptsim_jax.simulators.mujoco.build import make_stepped_model, turns_of_balls
from adaptsim_jax.simulators.mujoco.touching import touching


def load(data: Data, model: str | Path | None = None) -> Machine:
    """Read a recording (of a mechanism, in one log or several, or of the double pendulum of
    `task = "pendulum"`) and its model.

    Raises BadInput that names file, key and mend.
    """
    logs = logs_of(data)
    of_a_rig = len(logs) == 1 and declared_task(logs[0]) == "pendulum"
    join = _of_pendulum if of_a_rig else _joined
    if model is None or Path(model).suffix.lower() != ".toml":
        return join(data, model)
    given, declared = read_mended(model)
    return model_toml.applied(given, str(model), join(data, declared))


def read_mended(model: str | Path) -> tuple[dict[str, Any], Path]:
    """The table of a `model.toml` of a mechanism, and the declared model beside it. Raises
    BadInput.
    """
    given = read_model_table(model)
    declared = given.get("model")
    if given.get("task") == "simulator":
        raise BadInput(
            f"{model}: holds numbers of a simulator, which it does not bring; give the "
            "model.xml beside it"
        )
    if given.get("task") != "mechanism" or not isinstance(declared, str):
        raise BadInput(
            f"{model}: is no model of a mechanism; give the model.toml that diagnose wrote, or "
            "an MJCF or URDF file"
        )
    return given, Path(model).parent / declared


def _of_pendulum(data: Any, model: str | Path | None) -> Machine:
    """The recording of a rig with a model file of it."""
    if model is None:
        raise BadInput(
            f"{data}: a double pendulum's masses are not declared; give a model.xml or model.toml "
            "of it"
        )
    log = read_pendulum(data)
    return pendulum_machine(usable(log, audit(log)), model)


def _joined(data: Data, model: str | Path | None) -> Machine:
    """See `machine`. Raises BadInput where the base moves, which a tree of joints has not."""
    source, log = read_source_and_log(data, model)
    if base_moves(log):
        raise BadInput(
            f"{log.path}: the base moves, which a tree of joints has not; simulate it by MuJoCo "
            "(adaptsim replay, --fit), or ignore base_x .. base_qz where it stood still"
        )
    made = replace(machine(*joined(source, log)), source=source)
    if turns_of_balls(source, log):
        contact = ""
    else:
        contact = touching(make_stepped_model(source, log), log)
    if contact:
        return replace(made, beyond=(*made.beyond, contact))
    return made
