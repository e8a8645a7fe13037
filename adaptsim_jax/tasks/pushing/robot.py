"""What `adaptsim robot` says and reads for the push: speed and angle for each goal, and tracks of
the bottle in one file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from adaptsim_jax.logs.table import LogTable
from adaptsim_jax.tasks.base import SessionTrials, picked
from adaptsim_jax.tasks.camera_record import row_namer
from adaptsim_jax.tasks.pushing import measured
from adaptsim_jax.tasks.pushing.diagnosis.read import assemble
from adaptsim_jax.tasks.pushing.frame import check_frame
from adaptsim_jax.tasks.pushing.model import START
from adaptsim_jax.tasks.pushing.task import make_expectation
from adaptsim_jax.tasks.robot_trials import (
    AskedTrials,
    History,
    TrialSessions,
    config_of,
    write_actions,
)

if TYPE_CHECKING:
    from adaptsim_jax.commands.robot_session import RobotSession

HOW = """for each, with the bottle standing at x = 0.56, y = 0 m: push at that speed and angle, and track the bottle for {duration:g} s
write one CSV for all of them with columns trial, time, x, y (s since the arm's start; m in the arm's base frame)"""  # noqa: E501
COLUMNS = ("goal_x", "goal_y", "speed", "angle")
ENOUGH = 6  # pushes from which a diagnosis may say something; 12 to 24 serve
GRID = 24  # goals in best_actions.csv


class PushSessions(TrialSessions):
    """Pushes for goals, tracked by a camera."""

    trials = "pushes"
    columns = COLUMNS
    measured = measured
    keys = ("goal", "action", "points", "reward")
    result = "rewards"
    read_again = ("action",)

    @property
    def recorded(self) -> SessionTrials:
        options = ("friction", "coefficients")
        return SessionTrials("trial,speed,angle", self.rows_again, options, assemble)

    def how(self, config: Any) -> str:
        return HOW.format(duration=config.duration)

    def asked(self, context: Any, action: Any) -> str:
        return (
            f"speed {action[0]:.4f} m/s, angle {action[1]:+.4f} rad   (goal {context[0]:.3f}, "
            f"{context[1]:+.3f} m)"
        )

    def came(self, trajectory: Any) -> Iterator[str]:
        """How far each bottle ended from its goal."""
        ends = np.asarray(trajectory.points[:, -1])
        for goal, end, reward in zip(
            np.asarray(trajectory.goals), ends, trajectory.rewards, strict=True
        ):
            distance = 100 * np.linalg.norm(end - goal)
            yield (
                f"came to {end[0]:.3f}, {end[1]:+.3f} m, {distance:.1f} cm from its goal: reward "
                f"{float(reward):.3f}"
            )

    def ended(self, trial: Mapping[str, Any]) -> Any:
        return trial["points"][-1]

    def visiting(self, config: Any) -> Callable[[Any], Any] | None:
        return (lambda policy: policy) if config.visits == "deployed" else None

    def trajectory(
        self, session: RobotSession, tried: Any, asked: AskedTrials, table: LogTable, path: Path
    ) -> Any:
        config, where = config_of(session), str(path)
        found = measured.measured_trajectory(
            table.columns, row_namer(path, table), where, asked, config
        )
        if not session.as_declared:
            angles = asked.actions[:, 1]
            way = np.asarray(found.points[:, -1], float) - np.array(START)
            check_frame(asked.numbers.tolist(), angles, way, where)
        return make_expectation(config)(found, tried.policy)

    def advice(self, session: RobotSession, after: Any) -> None:
        """How to diagnose the pushes, once there are enough."""
        pushes = int(after.told) * config_of(session).trajectories
        if pushes >= ENOUGH:
            print(
                f"what the simulator lacks, by the {pushes} pushes: adaptsim diagnose "
                f"{session.folder} --out OUT"
            )

    def finish(self, session: RobotSession, policy: Any, history: History) -> None:
        """The best policy's pushes over the sector of goals, and the figure of all that were
        made.
        """
        path = session.folder / "best_actions.csv"
        pushes = measured.pushes_over_sector(policy, config_of(session), GRID)
        write_actions(path, COLUMNS, zip(*pushes, strict=True))
        if policy.told is not None:
            print(f"its actions are corrected by the {len(policy.told.used)} pushes told")
        print(f"written: {path}: its push for {GRID} goals; for any other:")
        print("  from adaptsim_jax.tasks.pushing.measured import read_policy")
        print(f"  speed, angle = read_policy({str(session.folder / 'best.toml')!r})([0.85, 0.02])")
        print(f"written: {_figure(session, history)}")


def _figure(session: RobotSession, history: History) -> Path:
    """The pushes as they were measured, a row a start, and the parameters of the start that holds
    the best.
    """
    import numpy as np

    from adaptsim_jax.report import figures as look
    from adaptsim_jax.report.figures_comparison import axes_of
    from adaptsim_jax.tasks.pushing import figures as draw

    turns = session.table["iterations"] + 1
    starts = [history[i : i + turns] for i in range(0, len(history), turns)]
    scores = np.array([[visit["score"] or 0.0 for visit in start] for start in starts])
    best = int(scores.max(1).argmax())
    panels, heads = [], []
    for first, row, start in zip(range(1, len(history) + 1, turns), scores, starts, strict=True):
        shown = picked(turns, int(row.argmax()))
        panels.append(
            [
                [draw.Push(p["goal"], p["points"], p["reward"]) for p in start[i]["pushes"]]
                for i in shown
            ]
        )
        heads.append([f"iteration {first + i}" for i in shown])
    params = np.array([list(visit["params"].values()) for visit in starts[best]])
    task = session.trained.phase1.task
    figure = draw.pushes_over_iterations(
        panels, heads, params, axes_of(task.space, session.kind.symbols), first=1 + best * turns
    )
    return look.save(figure, session.folder / "pushes.png")
