"""What `adaptsim robot` says and writes alike for tasks of single trials, the push and scooping."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from adaptsim_jax.commands.robot import Session


def config_of(session: Session) -> Any:
    """The task's configuration with which the session's run was trained."""
    from adaptsim_jax.core import config
    from adaptsim_jax.tasks.registry import TASKS

    kind = TASKS[session.trained.phase1.task.name].config
    return config.from_table(kind, session.options, str(session.table["run"]))


def opened(many: str) -> Callable[[Session, int], str]:
    """What says of what a new session consists; many: what an iteration's trials are called."""
    return lambda session, total: (
        f"session of {total} iterations of {config_of(session).trajectories} {many}"
    )


def policy_file(session: Session, policy: Any) -> dict[str, Any]:
    """What `policy.toml` holds beside the parameters; `read_policy` of the task's module `measured`
    reads it.
    """
    from importlib import import_module

    measured = import_module(f"adaptsim_jax.tasks.{session.trained.phase1.task.name}.measured")
    return measured.policy_table(policy, config_of(session))


def remembered(
    session: Session, mean: Any, many: str, keys: tuple[str, ...], trials: Iterable[tuple]
) -> dict[str, Any]:
    """The parameters and the trials of an iteration, for figures and for people: of each its number
    and what `keys` call.
    """
    import numpy as np

    def plain(x):
        return np.asarray(x, float).round(6).tolist()

    rows = [
        {"trial": int(n)} | dict(zip(keys, map(plain, parts), strict=True)) for n, *parts in trials
    ]
    return {"params": physical(session, mean), many: rows}


def physical(session: Session, mean: Any) -> dict[str, float]:
    """Parameters by name at the mean `[D]` of E."""
    space = session.trained.phase1.task.space
    return dict(zip(space.names, map(float, space.physical(mean)), strict=True))


def say_parameters(session: Session, before: Any, after: Any) -> None:
    """Print which parameters are believed in now, and which of them moved."""
    fresh = int(after.told) % (session.table["iterations"] + 1) == 0
    was, now = physical(session, before.mean), physical(session, after.mean)
    words = [
        f"{k} {now[k]:.4g}" + ("" if fresh or now[k] == was[k] else f" (was {was[k]:.4g})")
        for k in now
    ]
    print(f"{'next start' if fresh else 'simulate now with'}: {', '.join(words)}")


def write_actions(path: Path, columns: tuple[str, ...], trials: Iterable[tuple]) -> None:
    """A CSV with a row for each of `trials`: its number, then arrays of numbers."""
    from adaptsim_jax.core.files import write_bytes

    rows = [
        ",".join([str(n), *(f"{x:.6f}" for part in parts for x in part)]) for n, *parts in trials
    ]
    write_bytes(path, "\n".join([",".join(("trial", *columns)), *rows, ""]).encode())
