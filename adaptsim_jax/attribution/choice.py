"""Which simulator replays a recording: the tree of joints where it can, MuJoCo itself where it must
or is asked for.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from adaptsim_jax.attribution.criteria import CHOICE
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.declared import declared_task
from adaptsim_jax.logs.log import Log
from adaptsim_jax.logs.pool import Data, logs_of
from adaptsim_jax.logs.read import read_source_and_log
from adaptsim_jax.mechanisms.spec import Source
from adaptsim_jax.simulators.mujoco.build import make_stepped_model, turns_of_balls
from adaptsim_jax.simulators.mujoco.replay import replayed
from adaptsim_jax.simulators.mujoco.touching import touching


@dataclass(frozen=True)
class Choice:
    """simulator: tree or mujoco; why, in a sentence ('' where nothing needs to be said). File and
    log where they were read.
    """

    simulator: str
    why: str
    source: Source | None = None
    log: Log | None = None


def choose(data: Data, model: str | Path | None, asked: str | None, horizon: float) -> Choice:
    """For a recording and a model file. asked: `tree`, `mujoco`, or None: what meta.toml says, else
    what the model needs.

    Raises BadInput where the files cannot be read, or MuJoCo is asked for what is no model file.
    """
    own = model is not None and Path(model).suffix.lower() == ".toml"
    if own or declared_task(logs_of(data)[0]) == "pendulum":
        if asked == "mujoco":
            raise BadInput(
                f"{model or data}: simulator mujoco wants a model file (MJCF or URDF); give "
                "model.xml beside it"
            )
        return Choice("tree", "")
    return chosen(*read_source_and_log(data, model), asked, horizon)


def chosen(source: Source, log: Log, asked: str | None, horizon: float) -> Choice:
    """The same of files that were read: one rule for `replay` and `diagnose`."""
    asked = asked or log.meta.simulator
    if asked:
        return Choice(asked, "as asked for", source, log)
    if log.input_kind in ("voltage", "current") or turns_of_balls(source, log):
        return Choice("tree", "", source, log)
    if why := _needs(source, log):
        return Choice("mujoco", why, source, log)
    if source.kind == "mjcf" and _own(source, log, horizon):
        return Choice(
            "mujoco",
            f"the recording is the file's own simulation to {CHOICE.own_error:g} rad",
            source,
            log,
        )
    return Choice("tree", "", source, log)


def _needs(source: Source, log: Log) -> str:
    """What a tree of joints cannot do of a file over a recording, in words; '' where it can do
    all.
    """
    from adaptsim_jax.mechanisms.mjcf import mechanism_of

    if base_moves(log):
        return "its base moves"
    if log.meta.channels:
        return "sensors of the model are compared"
    if not log.joint_names:
        return "it has no joint but its base's"
    hold = {
        name: value
        for name, value in log.held.items()
        if value is not None or name in log.meta.hold
    }
    try:
        mechanism = mechanism_of(source, hold, log.joint_names, log.meta.path)
    except BadInput as error:  # nothing of a tree is left, or too much of it
        return str(error).removeprefix(f"{source.path}: ").split(";")[0]
    beyond = mechanism.unsupported + (
        mechanism.unsupported_drives if log.input_kind == "command" else ()
    )
    return "; ".join(beyond[:2]) or touching(make_stepped_model(source, log), log)


def base_moves(log: Log) -> bool:
    """Whether a logged base moves in any trial."""
    return any(
        t.base is not None and float(np.ptp(t.base, axis=0).max()) > CHOICE.base_range
        for t in log.trials
    )


def _own(source: Source, log: Log, horizon: float) -> bool:
    """Whether MuJoCo at the file's own step makes the recording, to `CHOICE.own_error`."""
    return (
        float(np.median(replayed(source, log, horizon, CHOICE.stretches).error)) < CHOICE.own_error
    )
