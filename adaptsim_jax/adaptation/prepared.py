"""What a task learns once, before Phase 1 (`Task.preparation`): made, kept beside a run or beside
compiled programs, and read back.
"""

import os
import sys
from datetime import datetime
from pathlib import Path
from typing import Any

import jax

from adaptsim_jax.core import compile_cache, config, store
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.progress import Report, silent
from adaptsim_jax.tasks.base import Preparation, Task

FOLDER = "prepared"
MAX_PREPARED = 64  # preparations kept beside compiled programs; the oldest go


def prepared(
    task: Task,
    seed: int = 0,
    folder: str | os.PathLike | None = None,
    report: Report = silent,
    make: bool = True,
) -> Task:
    """`task` with what it learns once, where it learns anything.

    Args:
        seed: with the task's own digest it says what was learned.
        folder: of the run that keeps it; None: it is kept with the compiled programs, for whoever
                asks for the same.
        make: False where it must be there already.

    Returns:
        The task, ready. BadInput where it is not there and may not be made.
    """
    made = task.preparation
    if made is None:
        return task
    return made.ready(learned(task, made, seed, folder, report, make))


def learned(
    task: Task,
    made: Preparation,
    seed: int,
    folder: str | os.PathLike | None,
    report: Report = silent,
    make: bool = True,
) -> Any:
    """What `made` learns, as `prepared` finds or makes it: a pytree of arrays."""
    digest = config.digest({"task": task.name, "seed": seed, "of": made.digest()})
    shared = compile_cache.folder() / FOLDER / digest[:32]
    own = None if folder is None else Path(folder) / FOLDER
    like = jax.eval_shape(made.blank, jax.random.key(0))
    for place in [p for p in (own, shared) if p is not None and (p / store.MANIFEST).exists()]:
        if store.read_manifest(place)["config_hash"] != digest:
            if place == own:
                raise BadInput(
                    f"{folder}: the environment (or JAX, which traces it) was changed since its "
                    "policy was trained; train in another folder"
                )
            continue
        tree, _ = store.load_checkpoint(place, like, task=task.name)
        if place == shared:
            _report_reuse(place)
            if own is not None:
                _keep(own, tree, task.name, digest)
        return tree
    if not make:
        raise BadInput(
            f"{folder}: its policy was not trained yet; run `adaptsim train` with --resume first"
        )
    tree = made.make(jax.random.key(seed), report)
    for place in filter(
        None, (own, shared if os.environ.get("JAX_ENABLE_COMPILATION_CACHE") != "false" else None)
    ):
        _keep(place, tree, task.name, digest)
    return tree


def _report_reuse(place: Path) -> None:
    """A line: the policy is that of an earlier run, trained for the same."""
    trained = datetime.fromtimestamp((place / store.MANIFEST).stat().st_mtime)
    print(
        f"prepared: the policy trained on {trained:%Y-%m-%d %H:%M} is taken again, for the "
        "environment, its fields, the training and the seed are the same (to train anew, remove "
        f"{place})",
        file=sys.stderr,
    )


def _keep(place: Path, tree, task: str, digest: str) -> None:
    store.save_checkpoint(place, tree, task=task, step=0, config_hash=digest)
    if place.name != FOLDER:
        others = sorted(place.parent.glob("*/" + store.MANIFEST), key=lambda p: p.stat().st_mtime)
    else:
        others = []
    for old in others[:-MAX_PREPARED]:
        for part in old.parent.iterdir():
            part.unlink(missing_ok=True)
        old.parent.rmdir()
