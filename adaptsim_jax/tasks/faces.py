"""What `adaptsim adapt` and `adaptsim robot` leave to a task: a record of functions each.

What a task may do without has a default.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from adaptsim_jax.tasks.base import Task

if TYPE_CHECKING:
    from adaptsim_jax.commands.robot_session import RobotSession
    from adaptsim_jax.report.film import Scene

COLUMNS = 6  # iterations that a figure shows at most


class AdaptView(NamedTuple):
    """An adaptation in a simulated target, as it is looked at.

    config: the task's options. target: its name; values `[D]` physical. result: of Phase 2. start:
    the one whose best visit is deployed; best: that visit. prepared: `(task, config) -> what the
    run learned once`, of tasks with a preparation.
    """

    task: Task
    config: Any
    target: str
    values: Any
    result: Any
    start: int
    best: int
    prepared: Callable[[Task], Any]

    def of_start(self, leaf: Any) -> Any:
        """`leaf [N, I + 1, ...]` of the history, at the start."""
        import numpy as np

        return np.asarray(leaf)[self.start]

    @property
    def policies(self) -> Any:
        """Of the start's visits `[I + 1]`."""
        import jax

        return jax.tree.map(lambda x: x[self.start], self.result.history.policy)

    @property
    def params(self) -> Any:
        """Parameters `[I + 1, D]` that the start's visits were trained at, physical."""
        import numpy as np

        return np.asarray(self.task.space.physical(self.result.history.mean[self.start]))

    def picked(self, count: int) -> tuple[list[int], list[str]]:
        """Which of `count` iterations a figure shows, and their titles."""
        shown = picked(count, self.best)
        return shown, [f"iteration {i}" + (" (best)" if i == self.best else "") for i in shown]

    def trials_reported(self) -> int | None:
        """How many trials the deployed policy is corrected by; None where it is not."""
        import numpy as np

        reported = getattr(self.result.policy, "told", None)
        if reported is None:
            return None
        return int(np.sum(reported.used))


def picked(count: int, best: int) -> list[int]:
    """The first, the last and evenly between them; the best takes the place of the one nearest to
    it.
    """
    import numpy as np

    shown = sorted({round(i) for i in np.linspace(0, count - 1, min(COLUMNS, count))})
    if best not in shown:
        last = len(shown) - 1
        shown[min(range(len(shown)), key=lambda k: (abs(shown[k] - best), k in (0, last)))] = best
    return shown


class Look(NamedTuple):
    """What there is to be looked at of policies in a target: a figure, notes for a person, the
    clips of a film, which are made when they are asked for, and how each trial ended, in words.
    """

    figure: Any
    clips: Callable[[], list[Any]]
    notes: tuple[str, ...] = ()
    ends: tuple[str, ...] = ()


@dataclass(frozen=True)
class AdaptFace:
    """Of `adapt`.

    picture: name of the figure's file, without suffix. shown: the adaptation. scene: how its
    trials are filmed. before_after: `(config, policies [2], target [D])`, the first and the
    deployed policy. as_compared: whether Phase 2 makes the visits and corrections of `compare`.
    deployed: `(config, result, target [D]) -> result` with policies and rewards as they are
    deployed.
    """

    picture: str
    shown: Callable[[AdaptView], Look]
    scene: Callable[[], Scene]
    before_after: Callable[[Any, Any, Any], Look] | None = None
    as_compared: Callable[[Any], bool] = lambda config: False
    deployed: Callable[[Any, Any, Any], Any] = lambda config, result, target: result


class SessionTrials(NamedTuple):
    """How trials of a session are read again, to be diagnosed: `head` and `rows(visit)` of the file
    of actions, which of the task's options say how the trials were made, and `assemble(actions,
    files, options, folder, as_declared=, without=) -> recording`.
    """

    head: str
    rows: Callable[[dict[str, Any]], list[tuple]]
    options: tuple[str, ...]
    assemble: Callable[..., Any]


@dataclass(frozen=True)
class RobotFace:
    """Of `robot`. turn: what one ask and tell is called. `history`: of the turns recorded so far,
    as `remember` made them.

    deployed: the policy as it is deployed now, mended by what was recorded; tried: as the coming
    turn makes its trials with it. Both are the policy itself by default. again: a turn that the
    robot could not finish is asked again. Else its start is given up, since the policy asked of it
    would fail again. recorded: how trials are read again for `diagnose`; None where sessions are not
    diagnosed.
    """  # noqa: E501

    turn: str
    opened: Callable[[Any, int], str]  # (session, turns) -> what a new session consists of
    # (session, policy as deployed) -> what policy.toml holds of it
    policy_file: Callable[[Any, Any], dict[str, Any]]
    # (session, state as tried, policy as deployed, history, done)
    show: Callable[[Any, Any, Any, list, bool], None]
    read: Callable[[Any, Any, Any], Any]  # (session, state as tried, path) -> trajectory
    # (session, state as tried, trajectory) -> entry of the history beside the score
    remember: Callable[[Any, Any, Any], dict[str, Any]] = lambda session, tried, trajectory: {}
    # (session, state as tried, state after, trajectory, done): what is said beside the return
    comment: Callable[[Any, Any, Any, Any, bool], None] = lambda *turn: None
    deployed: Callable[[Any, Any, list], Any] = lambda session, policy, history: policy
    tried: Callable[[Any, Any, list], Any] = lambda session, policy, history: policy
    again: bool = True
    recorded: Callable[[], SessionTrials] | None = None


def config_of(session: RobotSession) -> Any:
    """The task's configuration with which the session's run was trained."""
    from adaptsim_jax.core import config

    return config.from_table(session.kind.config, session.options, str(session.table["run"]))


def opened(trials: str) -> Callable[[RobotSession, int], str]:
    """What says of what a new session consists; trials: what those of an iteration are called."""

    def words(session: RobotSession, total: int) -> str:
        return f"session of {total} iterations of {config_of(session).trajectories} {trials}"

    return words


def remembered(
    session: RobotSession, mean: Any, name: str, keys: tuple[str, ...], trials: Iterable[tuple]
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
    return {"params": physical(session, mean), name: rows}


def physical(session: RobotSession, mean: Any) -> dict[str, float]:
    """Parameters by name at the mean `[D]` of E."""
    space = session.trained.phase1.task.space
    return dict(zip(space.names, map(float, space.physical(mean)), strict=True))


def print_parameters(session: RobotSession, before: Any, after: Any) -> None:
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
