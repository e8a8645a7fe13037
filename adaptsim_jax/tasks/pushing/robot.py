"""What `adaptsim robot` says and reads for the push: speed and angle for each goal, and the
bottle's tracks in one file.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from adaptsim_jax.tasks.faces import (
    RobotFace,
    SessionTrials,
    config_of,
    opened,
    print_parameters,
    remembered,
    write_actions,
)

if TYPE_CHECKING:
    from adaptsim_jax.commands.robot_session import RobotSession
    from adaptsim_jax.tasks.pushing.measured import Pushes

TURN = "iteration"
COLUMNS = ("goal_x", "goal_y", "speed", "angle")  # of actions.csv, after the trial
HOW = """for each, with the bottle standing at x = 0.56, y = 0 m: push at that speed and angle, and track the bottle for {duration:g} s
write one CSV for all of them with columns trial, time, x, y (s since the arm's start; m in the arm's base frame)"""  # noqa: E501
ENOUGH = 6  # pushes from which a diagnosis may say something; 12 to 24 serve
GRID = 24  # goals in best_actions.csv


def deployed(session: RobotSession, policy: Any, history: list[dict[str, Any]]) -> Any:
    """The policy as it would be deployed now, corrected by the pushes told so far where the task
    does that.
    """
    from adaptsim_jax.tasks.pushing.measured import corrected

    pushes = [push for visit in history for push in visit["pushes"]]
    actions, places = [p["action"] for p in pushes], [p["points"][-1] for p in pushes]
    return corrected(policy, config_of(session), actions, places)


def tried(session: RobotSession, policy: Any, history: list[dict[str, Any]]) -> Any:
    """The policy as the coming iteration makes its pushes: E's own, or what is deployed now
    (`task.visits`).
    """
    if config_of(session).visits == "deployed":
        return deployed(session, policy, history)
    return policy


def policy_file(session: RobotSession, policy: Any) -> dict[str, Any]:
    """What `policy.toml` holds beside the parameters; `measured.read_policy` reads it."""
    from adaptsim_jax.tasks.pushing.measured import policy_table

    return policy_table(policy, config_of(session))


def show(
    session: RobotSession, state: Any, policy: Any, history: list[dict[str, Any]], done: bool
) -> None:
    """Print the pushes to make and write them to actions.csv. When all is told, the best policy's
    over the sector of goals.
    """
    if done:
        _best(session, policy)
        print(f"written: {_figure(session, history)}")
        return
    pushes = _pushes(session, state)
    path = session.folder / "actions.csv"
    for number, goal, action in zip(*pushes, strict=True):
        print(
            f"  trial {number}: speed {action[0]:.4f} m/s, angle {action[1]:+.4f} rad   (goal "
            f"{goal[0]:.3f}, {goal[1]:+.3f} m)"
        )
    write_actions(path, COLUMNS, zip(*pushes, strict=True))
    print(f"written: {path}")
    print(HOW.format(duration=config_of(session).duration))


def read(session: RobotSession, state: Any, path: Path) -> Any:
    """The trajectory of the pushes that were asked for."""
    import numpy as np

    from adaptsim_jax.logs.table import read_table
    from adaptsim_jax.tasks.pushing import measured
    from adaptsim_jax.tasks.pushing.frame import check_frame, check_order
    from adaptsim_jax.tasks.pushing.model import START
    from adaptsim_jax.tasks.pushing.task import make_expectation

    table = read_table(path, measured.COLUMNS, min_rows=1, lost=("x", "y"))

    def at(i):
        return f"{path}: {table.row_word} {table.lines[i]}"

    config, pushes = config_of(session), _pushes(session, state)
    found = measured.measured_trajectory(
        table.columns, at, str(path), pushes, config, session.as_declared
    )
    if not session.as_declared:
        ends = np.asarray(found.points[:, -1], float)
        if slight := check_frame(pushes.actions[:, 1], ends - np.array(START), str(path)):
            print(f"warning: {slight}, where the robot does not turn its pushes itself")
        check_order(
            pushes.numbers.tolist(), pushes.actions[:, 1], ends - np.array(START), str(path)
        )
    return make_expectation(config)(found, state.policy)


def remember(session: RobotSession, before: Any, trajectory: Any) -> dict[str, Any]:
    """The pushes and what came of them."""
    rows = zip(*_pushes(session, before), trajectory.points, trajectory.rewards, strict=True)
    return remembered(session, before.mean, "pushes", ("goal", "action", "points", "reward"), rows)


def comment(session: RobotSession, before: Any, after: Any, trajectory: Any, done: bool) -> None:
    """How far each bottle ended from its goal, and which parameters are believed in now."""
    import numpy as np

    ends = np.asarray(trajectory.points[:, -1])
    for number, goal, end, reward in zip(
        _pushes(session, before).numbers,
        np.asarray(trajectory.goals),
        ends,
        trajectory.rewards,
        strict=True,
    ):
        distance = 100 * np.linalg.norm(end - goal)
        print(
            f"  trial {number}: came to {end[0]:.3f}, {end[1]:+.3f} m, {distance:.1f} cm from its "
            f"goal: reward {float(reward):.3f}"
        )
    pushes = int(after.told) * config_of(session).trajectories
    if pushes >= ENOUGH:
        print(
            f"what the simulator lacks, by the {pushes} pushes: adaptsim diagnose {session.folder} "
            "--out OUT"
        )
    if done:
        return
    print_parameters(session, before, after)


def _best(session: RobotSession, policy: Any) -> None:
    from adaptsim_jax.tasks.pushing.measured import pushes_over_sector

    path = session.folder / "best_actions.csv"
    write_actions(
        path, COLUMNS, zip(*pushes_over_sector(policy, config_of(session), GRID), strict=True)
    )
    if policy.told is not None:
        print(f"its actions are corrected by the {len(policy.told.used)} pushes told")
    print(f"written: {path}: its push for {GRID} goals; for any other:")
    print("  from adaptsim_jax.tasks.pushing.measured import read_policy")
    print(f"  speed, angle = read_policy({str(session.folder / 'best.toml')!r})([0.85, 0.02])")


def _figure(session: RobotSession, history: list[dict[str, Any]]) -> Path:
    """The pushes as they were measured, a row a start, and the parameters of the start that holds
    the best.
    """
    import numpy as np

    from adaptsim_jax.report import figures as look
    from adaptsim_jax.report.figures_comparison import axes_of
    from adaptsim_jax.tasks.faces import picked
    from adaptsim_jax.tasks.pushing import figures as draw
    from adaptsim_jax.tasks.pushing.adapt import SYMBOLS

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
        panels, heads, params, axes_of(task.space, SYMBOLS), first=1 + best * turns
    )
    return look.save(figure, session.folder / "pushes.png")


def _pushes(session: RobotSession, state: Any) -> Pushes:
    from adaptsim_jax.tasks.pushing.measured import pushes_to_make

    return pushes_to_make(state.key, state.told, state.policy, config_of(session))


def recorded() -> SessionTrials:
    """The pushes of a session, for `diagnose`."""
    from adaptsim_jax.tasks.pushing.diagnosis.read import assemble

    def rows(visit):
        return [(p["trial"], *p["action"]) for p in visit["pushes"]]

    return SessionTrials("trial,speed,angle", rows, ("friction", "coefficients"), assemble)


ROBOT = RobotFace(
    TURN,
    opened("pushes"),
    policy_file,
    show,
    read,
    remember,
    comment,
    deployed,
    tried,
    recorded=recorded,
)
