"""Writers of runs and of a robot's session that are killed at random moments, half of them by
SIGTERM, again and again in the same folder.

    # kills, seed; exit status 1 and a line at the first that lost anything
    python -m tests.faults.killed FOLDER 1000 0

The writers do what `train` and `robot record` do between two steps, without what is computed in
them: rows of metrics and then the checkpoint; the record before for `undo`, and then the session's
own checkpoint.
"""

import os
import random
import signal
import sys
import time
from pathlib import Path

import numpy as np

from adaptsim_jax.cli import STOPPED
from adaptsim_jax.core import store, tree_store  # noqa: F401  (imported before the forks, so that these begin at once)
from adaptsim_jax.core.process import stopped_by_sigterm

LIKE = {"state": np.zeros(4000, np.float32), "step": np.zeros((), np.int32)}
LONGEST = 0.25  # s that a writer lives


def state(step: int) -> dict[str, np.ndarray]:
    return {"state": np.full(4000, step, np.float32), "step": np.int32(step)}


def run_of(folder: Path) -> store.RunFolder:
    config = {"seed": 0}
    if (folder / "config.toml").exists():
        return store.RunFolder.resume(folder, config, task="killed")
    return store.RunFolder.create(folder, config, task="killed")


def write_run(folder: Path) -> None:
    """As `train`: three rows of metrics a step, and the checkpoint."""
    run = run_of(folder)
    _, step = run.restore(LIKE)
    while True:
        run.append_metrics([{"row": 3 * step + k} for k in range(3)])
        step += 1
        run.save(state(step), step)


def write_session(folder: Path) -> None:
    """As `robot record`: what was before, and what is now."""
    at = folder / "checkpoint"
    step = (
        store.load_checkpoint(at, LIKE, task="killed")[1]
        if at.exists() and any(at.glob("manifest.json"))
        else 0
    )

    def save(place, n):
        return store.save_checkpoint(place, state(n), task="killed", step=n, config_hash="")

    while True:
        save(folder / "undo" / str(step), step)
        step += 1
        save(at, step)


def check_run(folder: Path) -> int:
    """Steps that are there. ValueError where anything is torn, doubled or lost."""
    run = run_of(folder)
    tree, step = run.restore(LIKE)
    rows = [row["row"] for row in run.read_metrics()]
    if rows != list(range(3 * step)) or not np.all(np.asarray(tree["state"]) == step):
        raise ValueError(
            f"step {step}: {len(rows)} rows of metrics, state {np.asarray(tree['state'])[0]}"
        )
    return step


def check_session(folder: Path) -> int:
    """The same of a session, all of whose records can be taken back."""
    if not (folder / "checkpoint" / store.MANIFEST).exists():
        return 0
    tree, step = store.load_checkpoint(folder / "checkpoint", LIKE, task="killed")
    for n in range(max(0, step - 5), step):
        before, there = store.load_checkpoint(folder / "undo" / str(n), LIKE, task="killed")
        if there != n or not np.all(np.asarray(before["state"]) == n):
            raise ValueError(f"undo of record {n} is of {there}")
    if not np.all(np.asarray(tree["state"]) == step):
        raise ValueError(f"step {step} holds another state")
    return step


def _ended(child: int, by: signal.Signals) -> int:
    """The exit code of a child that is sent a signal, again each second: Python loses what it
    raises within a `__del__`.
    """
    while True:
        os.kill(child, by)
        for _ in range(100):
            time.sleep(0.01)
            there, status = os.waitpid(child, os.WNOHANG)
            if there:
                return os.waitstatus_to_exitcode(status)


def campaign(folder: Path, kills: int, seed: int) -> tuple[int, int]:
    """Steps that the run and the session came to. ValueError at the first kill that lost
    anything.
    """
    draw = random.Random(seed)
    ends = [0, 0]
    for kill in range(kills):
        which = kill % 2
        write, check = ((write_run, check_run), (write_session, check_session))[which]
        place = folder / ("run", "session")[which]
        if (child := os.fork()) == 0:
            code = 1
            try:
                with stopped_by_sigterm():
                    write(place)
            except KeyboardInterrupt:
                code = STOPPED
            finally:
                os._exit(code)
        time.sleep(draw.uniform(0.0, LONGEST))
        by = (signal.SIGKILL, signal.SIGTERM)[kill // 2 % 2]
        if _ended(child, by) not in (-by, STOPPED):
            raise ValueError(f"kill {kill}: the writer had ended by itself")
        step = check(place)
        if step < ends[which]:
            raise ValueError(f"kill {kill}: step {step} after {ends[which]}")
        ends[which] = step
    return ends[0], ends[1]


if __name__ == "__main__":
    try:
        print(*campaign(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])))
    except Exception as error:
        sys.exit(f"{type(error).__name__}: {error}")
