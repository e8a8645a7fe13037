"""Sessions of `adaptsim robot` with short trials that a camera sees: asked for, read, remembered
and reported alike, whatever is pushed or scooped.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core import config
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.files import write_bytes
from adaptsim_jax.logs.table import LogTable, read_table
from adaptsim_jax.tasks.base import RobotFace

if TYPE_CHECKING:
    from adaptsim_jax.commands.robot_session import RobotSession

History = list[Table]


class AskedTrials(NamedTuple):
    """What to do on the robot now.

    numbers `[N]` int, counted over the session; contexts `[N, 2]` m: goals, or places of the piece;
    actions `[N, d]` in the task's units.
    """

    numbers: np.ndarray
    contexts: np.ndarray
    actions: np.ndarray


def asked_trials(turn: Any, contexts: Any, actions: Any) -> AskedTrials:
    """The trials of iteration `turn` (from 0), numbered after those of the iterations before."""
    numbers = int(turn) * len(contexts) + np.arange(1, len(contexts) + 1)
    return AskedTrials(numbers, np.asarray(contexts), np.asarray(actions))


def corrected_by(
    policy: Any, config: Any, kind: type, bounds: Any, actions: Any, ended: Any
) -> Any:
    """The policy as it is deployed after trials that all count: corrected by them, `kind(actions in
    [-1, 1], how they ended, used)`, where there are any and the task does that (`correct`).
    `actions [K, d]` lie between the two `bounds [d]`.
    """
    if not (config.correct and len(actions)):
        return policy
    low, high = map(np.asarray, bounds)
    own = (2.0 * np.asarray(actions, float) - low - high) / (high - low)
    both = (jnp.asarray(x, jnp.float32) for x in (own, ended))
    return policy._replace(told=kind(*both, jnp.ones(len(own), bool)))


class TrialSessions(RobotFace):
    """What sessions of short trials have in common; a task says the rest in a class of its own.

    trials: What they are called. columns: Of actions.csv, after the trial. measured: The task's
    module of that name, with `trials_to_make`, `corrected`, `policy_table` and `COLUMNS`. keys:
    What a remembered trial holds beside its number: context, action, points and result. result:
    Which field of the trajectory `[N]` is the result. read_again: Keys that `diagnose` reads again.
    """

    turn = "iteration"
    trials: str
    columns: tuple[str, ...]
    measured: ModuleType
    keys: tuple[str, ...]
    result: str
    read_again: tuple[str, ...]

    def how(self, config: Any) -> str:
        """What a person is to do."""
        raise NotImplementedError

    def asked(self, context: Any, action: Any) -> str:
        """A trial in words."""
        raise NotImplementedError

    def came(self, trajectory: Any) -> Iterable[str]:
        """How each trial ended, in words."""
        raise NotImplementedError

    def ended(self, trial: Mapping[str, Any]) -> Any:
        """What of a remembered trial corrects the policy."""
        raise NotImplementedError

    def trajectory(
        self, session: RobotSession, tried: Any, asked: AskedTrials, table: LogTable, path: Path
    ) -> Any:
        """The trajectory of the trials that were asked for, by a camera's table."""
        raise NotImplementedError

    def finish(self, session: RobotSession, policy: Any, history: History) -> None:
        """What is said and written when all is reported."""

    def visiting(self, config: Any) -> Callable[[Any], Any] | None:
        """`(policy as deployed) -> policy of the coming iteration`; None where these are E's
        own.
        """

    def advice(self, session: RobotSession, after: Any) -> None:
        """What is said after each iteration."""

    def opened(self, session: RobotSession, total: int) -> str:
        count = config_of(session).trajectories
        return f"session of {total} iterations of {count} {self.trials}"

    def policy_file(self, session: RobotSession, policy: Any) -> Table:
        """`measured.read_policy` reads it."""
        return self.measured.policy_table(policy, config_of(session))

    def deployed(self, session: RobotSession, policy: Any, history: History) -> Any:
        """Corrected by the trials reported so far where the task does that."""
        made = [trial for visit in history for trial in visit[self.trials]]
        actions, ended = [t["action"] for t in made], [self.ended(t) for t in made]
        return self.measured.corrected(policy, config_of(session), actions, ended)

    def tried(self, session: RobotSession, policy: Any, history: History) -> Any:
        """E's own, or of what is deployed."""
        visit = self.visiting(config_of(session))
        return visit(self.deployed(session, policy, history)) if visit else policy

    def make(self, session: RobotSession, state: Any) -> AskedTrials:
        """The trials that the session asks for now."""
        return self.measured.trials_to_make(state.key, state.told, state.policy, config_of(session))

    def show(
        self, session: RobotSession, tried: Any, policy: Any, history: History, done: bool
    ) -> None:
        """Print the trials to make and write them to actions.csv; when all is reported, what the
        best policy does.
        """
        if done:
            self.finish(session, policy, history)
            return
        trials, path = self.make(session, tried), session.folder / "actions.csv"
        probing = getattr(tried.policy, "probe", None) is not None
        for number, context, action in zip(*trials, strict=True):
            words = self.asked(context, action)
            if probing and number == trials.numbers[-1]:
                words = f"{words.removesuffix(')')}, a probe)"
            print(f"  trial {number}: {words}")
        write_actions(path, self.columns, zip(*trials, strict=True))
        print(f"written: {path}")
        print(self.how(config_of(session)))

    def read(self, session: RobotSession, tried: Any, path: Path) -> Any:
        table = read_table(path, self.measured.COLUMNS, min_rows=1, lost=("x", "y"))
        return self.trajectory(session, tried, self.make(session, tried), table, path)

    def remember(self, session: RobotSession, tried: Any, trajectory: Any) -> Table:
        """The parameters and the trials of an iteration, for figures and for people."""
        results = getattr(trajectory, self.result)
        rows = zip(*self.make(session, tried), trajectory.points, results, strict=True)
        trials = [
            {"trial": int(number)} | dict(zip(self.keys, map(_plain, parts), strict=True))
            for number, *parts in rows
        ]
        return {"params": physical(session, tried.mean), self.trials: trials}

    def comment(
        self, session: RobotSession, tried: Any, after: Any, trajectory: Any, done: bool
    ) -> None:
        """How each trial ended, and which parameters are believed in now."""
        numbers = self.make(session, tried).numbers
        for number, words in zip(numbers, self.came(trajectory), strict=True):
            print(f"  trial {number}: {words}")
        self.advice(session, after)
        if not done:
            print_parameters(session, tried, after)

    def rows_again(self, visit: Mapping[str, Any]) -> list[tuple]:
        """A visit's trials, for `diagnose`."""
        return [
            (t["trial"], *(x for key in self.read_again for x in t[key]))
            for t in visit[self.trials]
        ]


def _plain(x: Any) -> Any:
    """Numbers to six digits, as JSON holds them."""
    return np.asarray(x, float).round(6).tolist()


def config_of(session: RobotSession) -> Any:
    """The task's configuration with which the session's run was trained."""
    return config.from_table(session.kind.config, session.options, str(session.table["run"]))


def physical(session: RobotSession, mean: Any) -> dict[str, float]:
    """Parameters by name at the mean `[D]` of E."""
    return session.trained.phase1.task.space.named(mean)


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
    rows = [
        ",".join([str(n), *(f"{x:.6f}" for part in parts for x in part)]) for n, *parts in trials
    ]
    write_bytes(path, "\n".join([",".join(("trial", *columns)), *rows, ""]).encode())
