"""What a session of `adaptsim robot` has recorded, as trials to be diagnosed."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any


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
    from adaptsim_jax.commands.robot_session import located
    from adaptsim_jax.core import store
    from adaptsim_jax.tasks.registry import TASKS

    trials = TASKS[session_task(folder)].robot.recorded()
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


def _same_file(folder: Path, visit: dict[str, Any]) -> Path:
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
