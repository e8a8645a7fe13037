"""What `adaptsim robot` says and reads for scooping: pitch, pitch rate and distance for each place,
and the tracks in one file.
"""

from __future__ import annotations

from functools import partial
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
    from adaptsim_jax.tasks.scooping.measured import Scoops

TURN = "iteration"
COLUMNS = ("place_x", "place_y", "pitch", "rate", "distance")  # of actions.csv, after the trial
HOW = """for each, lay the piece at that place (m from the middle of a box of 8 x 6 cm, x along the spatula's way), start at
that pitch and distance, scoop with that pitch rate at 0.25 s, and track the piece for {seconds:g} s; write one CSV for all of them
with columns trial, time, x, y, on (s since the arm's start; m; 1 where the piece lies on the spatula, else 0)"""  # noqa: E501


def deployed(session: RobotSession, policy: Any, history: list[dict[str, Any]]) -> Any:
    """The policy as it would be deployed now, corrected by the scoops told so far where the task
    does that.
    """
    from adaptsim_jax.tasks.scooping.measured import corrected

    scoops = [scoop for visit in history for scoop in visit["scoops"]]
    return corrected(
        policy, config_of(session), [s["action"] for s in scoops], [s["success"] for s in scoops]
    )


def tried(session: RobotSession, policy: Any, history: list[dict[str, Any]]) -> Any:
    """The policy as the coming iteration makes its scoops: where it is corrected, the last of them
    is a probe.
    """
    import jax

    from adaptsim_jax.tasks.scooping.deployed import make_probe

    config = config_of(session)
    if config.correct:
        return jax.jit(make_probe(config))(deployed(session, policy, history))
    return policy


def policy_file(session: RobotSession, policy: Any) -> dict[str, Any]:
    """What `policy.toml` holds beside the parameters; `measured.read_policy` reads it."""
    from adaptsim_jax.tasks.scooping.measured import policy_table

    return policy_table(policy, config_of(session))


def show(
    session: RobotSession, state: Any, policy: Any, history: list[dict[str, Any]], done: bool
) -> None:
    """Print the scoops to make and write them to actions.csv. When all is told, how the best policy
    is used.
    """
    from adaptsim_jax.tasks.scooping.model import SECONDS

    if done:
        from adaptsim_jax.tasks.scooping.measured import scoop_in_the_middle

        action = scoop_in_the_middle(policy, config_of(session))
        if policy.told is not None:
            print(f"its scoop is corrected by the {len(policy.told.used)} scoops told")
        print(f"its scoop for a piece in the middle: {_in_words(action)}; for any other place (m):")
        print("  from adaptsim_jax.tasks.scooping.measured import read_policy")
        print(
            f"  pitch, rate, distance = read_policy({str(session.folder / 'best.toml')!r})([0.01, "
            "0.02])"
        )
        return
    scoops = _scoops(session, state)
    path = session.folder / "actions.csv"
    for number, place, action in zip(*scoops, strict=True):
        if state.policy.probe is not None and number == scoops.numbers[-1]:
            probe = ", a probe"
        else:
            probe = ""
        print(
            f"  trial {number}: {_in_words(action)}   (piece at {place[0]:+.3f}, {place[1]:+.3f} "
            f"m{probe})"
        )
    write_actions(path, COLUMNS, zip(*scoops, strict=True))
    print(f"written: {path}")
    print(HOW.format(seconds=SECONDS))


def read(session: RobotSession, state: Any, path: Path) -> Any:
    """The trajectory of the scoops that were asked for."""
    import numpy as np

    from adaptsim_jax.logs.table import read_table
    from adaptsim_jax.tasks.scooping import measured

    table = read_table(path, measured.COLUMNS, min_rows=1, lost=("x", "y"))

    def at(i):
        return f"{path}: {table.row_word} {table.lines[i]}"

    scoops = _scoops(session, state)
    found = measured.measured_trajectory(table.columns, at, str(path), scoops, session.as_declared)
    if not session.as_declared:
        measured.check_way(
            np.asarray(found.points[:, -1], float), str(path), scoops.numbers.tolist()
        )
    return found


def remember(session: RobotSession, before: Any, trajectory: Any) -> dict[str, Any]:
    """The scoops and what came of them."""
    rows = zip(*_scoops(session, before), trajectory.points, trajectory.success, strict=True)
    return remembered(
        session, before.mean, "scoops", ("place", "action", "points", "success"), rows
    )


def comment(session: RobotSession, before: Any, after: Any, trajectory: Any, done: bool) -> None:
    """Which scoops succeeded, and which parameters are believed in now."""
    for number, success in zip(_scoops(session, before).numbers, trajectory.success, strict=True):
        print(f"  trial {number}: {'on the spatula' if success > 0.5 else 'not on the spatula'}")
    if done:
        return
    print_parameters(session, before, after)


def _in_words(action: Any) -> str:
    import math

    pitch, rate, distance = map(float, action)
    return (
        f"pitch {math.degrees(pitch):.2f} deg, pitch rate {rate:+.3f} rad/s, distance "
        f"{1e3 * distance:.1f} mm"
    )


def _scoops(session: RobotSession, state: Any) -> Scoops:
    from adaptsim_jax.tasks.scooping.measured import scoops_to_make

    return scoops_to_make(state.key, state.told, state.policy, config_of(session))


def recorded() -> SessionTrials:
    """The scoops of a session, for `diagnose`; each track is counted from where its piece lay."""
    from adaptsim_jax.tasks.scooping.diagnosis.read import assemble

    def rows(visit):
        return [(s["trial"], *s["place"], *s["action"]) for s in visit["scoops"]]

    head = "trial,place_x,place_y,pitch,rate,distance"
    return SessionTrials(head, rows, ("clearance",), partial(assemble, own_frame=True))


ROBOT = RobotFace(
    TURN,
    opened("scoops"),
    policy_file,
    show,
    read,
    remember,
    comment,
    deployed,
    tried,
    recorded=recorded,
)
