"""A session of `adaptsim robot` on disk: which run it goes by, its state and history, and what came
before each record.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from adaptsim_jax.core.config import Table

if TYPE_CHECKING:
    from adaptsim_jax.core.store import RunFolder

SESSION = "robot.toml"
UNDO = "undo"
PLACES = ("run", "run_from_here")
"""Keys of robot.toml that say where the run is, as a whole path and from the session's folder."""


class RobotSession(NamedTuple):
    """A session on disk: where it is, how it was started, the learned adaptation policy at work,
    the task's options, and the task as the registry holds it (`TaskKind`).
    """

    folder: Path
    table: Table
    trained: Any
    loop: Any
    options: Table
    kind: Any
    as_declared: bool = False  # what the record contradicts is taken all the same


def open_session(folder: Path, moved: str | None = None) -> RobotSession:
    """The session in `folder`; `moved`: where its run is now, which is written down once that run
    is known to be the one.
    """
    from adaptsim_jax.core import config

    table = located(folder, moved)
    session = make_session(folder, table)
    if moved is not None:
        config.write(folder / SESSION, table)
    return session


def located(folder: Path, moved: str | None = None) -> Table:
    """robot.toml of the session in `folder`, with its run where it is now."""
    from adaptsim_jax.core import config
    from adaptsim_jax.core.errors import BadInput
    from adaptsim_jax.core.store import check_version

    if not (folder / SESSION).exists():
        raise BadInput(
            f"{folder}: no session here; start one with 'adaptsim robot new RUN --dir {folder}'"
        )
    table = config.read(folder / SESSION)
    check_version(folder / SESSION, table)
    for name, kind in {
        "schema": int,
        "run": str,
        "run_from_here": str,
        "seed": int,
        "starts": int,
        "iterations": int,
        "trained": dict,
    }.items():
        if type(table.get(name)) is not kind:
            raise BadInput(
                f"{folder / SESSION}: key '{name}' is missing or no {kind.__name__}; restore the "
                "file"
            )
    run_folder = table["run"]
    if moved is not None:
        return table | places(str(Path(moved).resolve()), folder)
    if not Path(run_folder).is_dir():
        near = folder / table["run_from_here"]
        if not near.is_dir():
            raise BadInput(
                f"{run_folder}: no such run folder, which the session in {folder} goes by; if it "
                f"was moved, say where it is: adaptsim robot next --dir {folder} --run RUN"
            )
        return table | {"run": str(near.resolve())}
    return table


def places(run: str, folder: Path) -> dict[str, str]:
    """Where the run is: the whole path, and from the session's folder, which holds when both are
    moved together.
    """
    import os

    return {"run": run, "run_from_here": os.path.relpath(run, folder.resolve())}


def run_of(path: str) -> RunFolder:
    """The run at `path`, of a task that robots are for."""
    from adaptsim_jax.core.errors import BadInput
    from adaptsim_jax.core.store import RunFolder
    from adaptsim_jax.tasks.registry import TASKS

    run = RunFolder.open(path)
    if TASKS.named(run.task, "task").robot is None:
        able = ", ".join(name for name, kind in TASKS.items() if kind.robot is not None)
        raise BadInput(
            f"{path}: a run of task '{run.task}'; robot takes runs of {able} in this version. For "
            f"{run.task} use 'adaptsim adapt', or from Python adaptsim_jax.adaptation.asktell with "
            "recorded trajectories"
        )
    return run


def identity(run: RunFolder) -> Table:
    """Which adaptation policy the run holds now: its checkpoint's step and hashes."""
    from adaptsim_jax.core.store import read_manifest

    manifest = read_manifest(run.checkpoint)
    return {name: manifest[name] for name in ("step", "sha256", "config_hash")}


def _check_same(run: RunFolder, table: Table, folder: Path) -> None:
    """BadInput where the run's checkpoint is not the one that the session began with."""
    from adaptsim_jax.core.errors import BadInput

    began, now = table["trained"], identity(run)
    if began != now:
        raise BadInput(
            f"{run.path}: was trained on, or anew, since the session in {folder} began (checkpoint "
            f"of round {began.get('step')} then, another of round {now['step']} now); put that "
            "checkpoint back, or start another session with 'adaptsim robot new'"
        )


def make_session(folder: Path, table: Table) -> RobotSession:
    from adaptsim_jax.adaptation.asktell import loop_of
    from adaptsim_jax.adaptation.training import load_run
    from adaptsim_jax.tasks.registry import TASKS

    run = run_of(table["run"])
    trained = load_run(run)
    _check_same(run, table, folder)  # after the load, so that what was loaded is what is checked
    loop = loop_of(trained, table["iterations"])
    return RobotSession(folder, table, trained, loop, run.config.get("task", {}), TASKS[run.task])


Record = tuple[Any, list[Table]]
"""A state and the history that led to it."""


def advance(session: RobotSession, before: Record, after: Record) -> None:
    """Save what is so after a turn, and keep what was so before it for `undo`."""
    save(session, *before, session.folder / UNDO / str(len(before[1])))
    save(session, *after)


def _bound(table: Table) -> str:
    """Hash of what a session's checkpoints are bound to: all but where things are."""
    from adaptsim_jax.core import config

    return config.digest({name: value for name, value in table.items() if name not in PLACES})


def save(
    session: RobotSession, state: Any, history: list[Table], folder: Path | None = None
) -> None:
    from adaptsim_jax.core import store

    store.save_checkpoint(
        folder or session.folder / store.CHECKPOINT,
        state,
        task=session.trained.phase1.task.name,
        step=len(history),
        config_hash=_bound(session.table),
        extra={"history": history},
    )


def load(session: RobotSession, folder: Path | None = None) -> tuple[Any, list[Table]]:
    """State and history of the session, or of the record before in `folder`."""
    import jax
    import jax.numpy as jnp

    from adaptsim_jax.adaptation.phase1 import DistributionArchive
    from adaptsim_jax.core import store
    from adaptsim_jax.core.errors import BadInput

    task = session.trained.phase1.task
    folder = folder or session.folder / store.CHECKPOINT
    if store.read_manifest(folder)["config_hash"] != _bound(session.table):
        raise BadInput(
            f"{session.folder / SESSION}: was changed since the session began; restore the file"
        )

    def like(key):
        count = session.table["starts"]
        policy = jax.vmap(task.init_policy)(jax.random.split(key, count))
        return session.loop.init(
            key, DistributionArchive(jnp.zeros((count, task.space.dim)), policy)
        )

    state, _ = store.load_checkpoint(
        folder, jax.eval_shape(like, jax.random.key(0)), task=task.name
    )
    return state, store.read_manifest(folder)["extra"]["history"]


# ---------------------------------------------------------------- what was recorded
#
# What a session of `adaptsim robot` has recorded, as trials to be diagnosed.


def session_task(folder: Path) -> str:
    """The task of the session in `folder`. Raises BadInput where its sessions are not diagnosed."""
    from adaptsim_jax.core import store
    from adaptsim_jax.core.errors import BadInput
    from adaptsim_jax.tasks.registry import TASKS

    task = store.read_manifest(folder / store.CHECKPOINT).get("task")
    able = [name for name, kind in TASKS.items() if kind.robot and kind.robot.recorded]
    if task not in able:
        raise BadInput(
            f"{folder}: a session of task '{task}'; diagnose reads sessions of {', '.join(able)}"
        )
    return task


def recorded_trials(folder: Path, as_declared: bool = False, without: Sequence[str] = ()) -> Any:
    """All trials of the session in `folder` but those of `without`, from the files that `robot
    record` was given.

    Raises BadInput where a file is gone or another by now, or the session is of another task.
    """
    from adaptsim_jax.core import store
    from adaptsim_jax.tasks.registry import TASKS

    robot = TASKS[session_task(folder)].robot
    assert robot is not None and robot.recorded is not None  # of every `session_task`
    trials = robot.recorded
    files, rows = [], [trials.head]
    for visit in store.read_manifest(folder / store.CHECKPOINT)["extra"]["history"]:
        files.append(_same_file(folder, visit))
        rows += [",".join(map(str, row)) for row in trials.rows(visit)]
    options = store.RunFolder.open(located(folder)["run"]).config.get("task", {})
    meta = {k: options[k] for k in trials.options if k in options}
    with tempfile.TemporaryDirectory() as scratch:
        actions = Path(scratch) / "actions.csv"
        actions.write_text("\n".join([*rows, ""]))
        return trials.assemble(
            actions, files, meta, folder, as_declared=as_declared, without=without
        )


def _same_file(folder: Path, visit: Table) -> Path:
    """The file of a visit, which must be what was recorded."""
    from adaptsim_jax.core.errors import BadInput

    path = Path(visit["file"])
    try:
        same = hashlib.sha256(path.read_bytes()).hexdigest() == visit["sha256"]
    except OSError:
        raise BadInput(
            f"{path}: was told to the session in {folder} and is gone; put it back"
        ) from None
    if not same:
        raise BadInput(
            f"{path}: is not the file that was told to the session in {folder}; put that one back"
        )
    return path
