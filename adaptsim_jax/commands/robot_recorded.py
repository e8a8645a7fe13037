"""What a session of `adaptsim robot` has recorded, as pushes to be diagnosed."""

from __future__ import annotations

import hashlib
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from adaptsim_jax.tasks.pushing.diagnosis.read import Pushed


def recorded_pushes(folder: Path, as_declared: bool = False, without: Sequence[str] = ()) -> Pushed:
    """All pushes told to the session in `folder` but those of `without`, from the files that `robot record` was given.

    Raises BadInput where a file is gone or another by now, or the session is of another task.
    """
    from adaptsim_jax.commands.robot_session import located
    from adaptsim_jax.core import store
    from adaptsim_jax.core.errors import BadInput
    from adaptsim_jax.tasks.pushing.diagnosis.read import assemble

    manifest = store.read_manifest(folder / store.CHECKPOINT)
    if manifest.get("task") != "pushing":
        raise BadInput(f"{folder}: a session of task '{manifest.get('task')}'; diagnose reads sessions of pushing")
    history = manifest["extra"]["history"]
    files, rows = [], ["trial,speed,angle"]
    for visit in history:
        path = Path(visit["file"])
        try:
            same = hashlib.sha256(path.read_bytes()).hexdigest() == visit["sha256"]
        except OSError:
            raise BadInput(f"{path}: was told to the session in {folder} and is gone; put it back") from None
        if not same:
            raise BadInput(f"{path}: is not the file that was told to the session in {folder}; put that one back")
        files.append(path)
        rows += [f"{p['trial']},{p['action'][0]},{p['action'][1]}" for p in visit["pushes"]]
    run = located(folder)["run"]
    task = store.RunFolder.open(run).config.get("task", {})
    meta = {k: task[k] for k in ("friction", "coefficients") if k in task}
    with tempfile.TemporaryDirectory() as scratch:
        actions = Path(scratch) / "actions.csv"
        actions.write_text("\n".join([*rows, ""]))
        return assemble(actions, files, meta, folder, as_declared, without)
