"""What a session of `adaptsim robot` has recorded, as pushes or scoops to be diagnosed."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Sequence

    from adaptsim_jax.tasks.pushing.diagnosis.read import Pushed
    from adaptsim_jax.tasks.scooping.diagnosis.read import Scooped


def session_task(folder: Path, known: tuple[str, ...]) -> str:
    """The task of the session in `folder`. Raises BadInput where it is none of `known`."""
    from adaptsim_jax.core import store
    from adaptsim_jax.core.errors import BadInput

    task = store.read_manifest(folder / store.CHECKPOINT).get("task")
    if task not in known:
        raise BadInput(
            f"{folder}: a session of task '{task}'; diagnose reads sessions of {', '.join(known)}"
        )
    return task


def recorded_pushes(folder: Path, as_declared: bool = False, without: Sequence[str] = ()) -> Pushed:
    """All pushes told to the session in `folder` but those of `without`, from the files that `robot
    record` was given.

    Raises BadInput where a file is gone or another by now, or the session is of another task.
    """
    from adaptsim_jax.tasks.pushing.diagnosis.read import assemble

    def made(visit: dict[str, Any]) -> list[str]:
        return [f"{p['trial']},{p['action'][0]},{p['action'][1]}" for p in visit["pushes"]]

    told = partial(assemble, as_declared=as_declared, without=without)
    return _recorded(
        folder, "pushing", "trial,speed,angle", made, ("friction", "coefficients"), told
    )


def recorded_scoops(
    folder: Path, as_declared: bool = False, without: Sequence[str] = ()
) -> Scooped:
    """All scoops told to the session in `folder`, likewise; each track is counted from where its
    piece lay.
    """
    from adaptsim_jax.tasks.scooping.diagnosis.read import assemble

    def made(visit: dict[str, Any]) -> list[str]:
        return [
            ",".join(map(str, (s["trial"], *s["place"], *s["action"]))) for s in visit["scoops"]
        ]

    head = "trial,place_x,place_y,pitch,rate,distance"
    told = partial(assemble, as_declared=as_declared, without=without, own_frame=True)
    return _recorded(folder, "scooping", head, made, ("clearance",), told)


RECORDED: dict[str, Callable[..., Any]] = {"pushing": recorded_pushes, "scooping": recorded_scoops}


def _recorded(
    folder: Path, task: str, head: str, made: Callable, keys: tuple[str, ...], assemble: Callable
) -> Any:
    from adaptsim_jax.commands.robot_session import located
    from adaptsim_jax.core import store
    from adaptsim_jax.core.errors import BadInput

    session_task(folder, (task,))
    files, rows = [], [head]
    for visit in store.read_manifest(folder / store.CHECKPOINT)["extra"]["history"]:
        path = Path(visit["file"])
        try:
            same = hashlib.sha256(path.read_bytes()).hexdigest() == visit["sha256"]
        except OSError:
            raise BadInput(
                f"{path}: was told to the session in {folder} and is gone; put it back"
            ) from None
        if not same:
            raise BadInput(
                f"{path}: is not the file that was told to the session in {folder}; put that one "
                f"back"
            )
        files.append(path)
        rows += made(visit)
    options = store.RunFolder.open(located(folder)["run"]).config.get("task", {})
    meta = {k: options[k] for k in keys if k in options}
    with tempfile.TemporaryDirectory() as scratch:
        actions = Path(scratch) / "actions.csv"
        actions.write_text("\n".join([*rows, ""]))
        return assemble(actions, files, meta, folder)
