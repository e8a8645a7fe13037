"""`adaptsim robot`: Phase 2 one trial at a time, with its state on disk between calls."""

from __future__ import annotations

import argparse
import hashlib
from pathlib import Path
from typing import Any

from adaptsim_jax import __version__
from adaptsim_jax.commands import robot_session as sessions
from adaptsim_jax.commands.robot_session import SESSION, UNDO, RobotSession
from adaptsim_jax.core.config import Table

EXAMPLES = """
  adaptsim robot new runs/a --dir robot          start from a trained run
  adaptsim robot next --dir robot                what to run on the robot now
  adaptsim robot record trial.csv --dir robot    what was measured; then `next` again
  adaptsim robot record --failed --dir robot     the robot could not finish what `next` asked
  adaptsim robot undo --dir robot                take the last record back
  adaptsim robot next --dir robot --run runs/b   where the run is, after it was moved

RUN is the folder of `adaptsim train`. `next` says the policy or the actions each time, and the best ones when all is told.
FILE, a CSV (or npz), of the pendulum: one trial, from the moment of letting go: columns time [s], q1, q2 [rad, zero
upright], tau1, tau2 [N m], and v1, v2 [rad/s] where measured. Of the push: all pushes that `next` wrote to actions.csv:
columns trial, time [s since the arm's start], x, y [m, arm's base frame] of the bottle. Of scooping likewise: trial, time, x, y of
the piece [m, x along the spatula's way], and on, 1 where it lies on the spatula. Where the robot cannot finish a pendulum's
policy, that has no return and its start is given up; pushes and scoops that failed are asked again.
"""  # noqa: E501
STEPS = ("new", "next", "record", "undo")


def run(args: argparse.Namespace) -> int:
    """One step of ask/tell adaptation."""
    import contextlib
    import json
    import sys

    with contextlib.redirect_stdout(sys.stderr) if args.json else contextlib.nullcontext():
        answer = stepped(args)
    if args.json:
        print(json.dumps(answer, indent=1))
    return 0


def stepped(args: argparse.Namespace) -> Table:
    """What `--json` prints of a step: where the session stands and, of new and next, what is to be
    run now.
    """
    from adaptsim_jax.core.config import pick
    from adaptsim_jax.core.errors import BadInput
    from adaptsim_jax.core.files import one_writer, output_folder

    step = pick("step", args.step, STEPS)
    if args.failed and (step != "record" or args.what is not None):
        raise BadInput(
            "--failed: goes with 'robot record' and no FILE, for a trial that the robot could not "
            "finish"
        )
    wanted = {"new": "RUN", "record": "FILE"}.get(step)
    if wanted and args.what is None and not args.failed:
        if step == "record":
            more = " (or --failed, where the robot could not finish)"
        else:
            more = ""
        raise BadInput(f"robot {step}: {wanted} is missing{more}; see 'adaptsim robot --help'")
    if step == "new":
        if args.moved:
            raise BadInput(
                "--run: of a session that is there; 'robot new RUN' takes the run as it is"
            )
        return new(args)
    session = sessions.open_session(Path(args.dir), args.moved)._replace(
        as_declared=args.as_declared
    )
    with one_writer(output_folder(args.dir)):
        if step == "next":
            return ask(args, session)
        {"record": failed if args.failed else record, "undo": undo}[step](args, session)
        print(f"next: adaptsim robot next --dir {args.dir}")
        return stands(session)


def new(args: argparse.Namespace) -> Table:
    """Start a session in an empty folder."""
    from adaptsim_jax.adaptation.asktell import begun
    from adaptsim_jax.core import config, files
    from adaptsim_jax.core.errors import BadInput
    from adaptsim_jax.core.files import one_writer
    from adaptsim_jax.core.store import SCHEMA

    folder = Path(args.dir)
    if (folder / SESSION).exists():
        raise BadInput(
            f"{folder}: holds a session already; go on with 'adaptsim robot next --dir {folder}'"
        )
    path = str(Path(args.what).resolve())
    table = {
        "schema": SCHEMA,
        "version": __version__,
        **sessions.places(path, folder),
        "seed": args.seed,
        "starts": args.starts,
        "iterations": args.iterations,
        "trained": sessions.identity(sessions.run_of(path)),
    }
    session = sessions.make_session(folder, table)
    files.output_folder(folder)
    state = begun(session.loop, session.trained, args.starts, args.seed)
    with one_writer(folder):
        sessions.save(session, state, [])
        # written last: a folder with this file holds a whole session
        config.write(folder / SESSION, table)
        print(
            f"{session.kind.robot.opened(session, args.starts * (args.iterations + 1))} in {folder}"
        )
        return ask(args, session)


def stands(session: RobotSession) -> Table:
    """How many turns are told, and what the last and the best of them returned."""
    import math

    state, history = sessions.load(session)
    best = float(state.best_score)
    status = {
        "told": len(history),
        "of": session.loop.trials(state),
        "turn": session.kind.robot.turn,
    }
    last = history[-1]["score"] if history else None
    return status | {"last_return": last, "best_return": best if math.isfinite(best) else None}


def ask(args: argparse.Namespace, session: RobotSession) -> Table:
    """Say and write what to run now; when all is told, the best policy."""
    import math

    from adaptsim_jax.core import config
    from adaptsim_jax.tasks.robot_trials import physical

    state, history = sessions.load(session)
    total = session.loop.trials(state)
    done = len(history) >= total
    if done and not math.isfinite(state.best_score):
        print(
            f"all {total} {session.kind.robot.turn}s are told, and none of them was finished: "
            "there is no best policy"
        )
        print(
            "train where the robot can follow (a softer target, narrower ranges), or take records "
            "back: adaptsim robot undo"
        )
        return stands(session) | {"done": True}
    if done:
        mean, policy = (state.best_mean, state.best_policy)
    else:
        mean, policy = (state.mean, state.policy)
    policy = session.kind.robot.deployed(session, policy, history)
    params = physical(session, mean)
    if done:
        what = "best policy"
    else:
        what = f"{session.kind.robot.turn} {len(history) + 1} of {total}"
    print(
        f"{what}: trained at {', '.join(f'{name} {value:.4g}' for name, value in params.items())}"
    )
    path = session.folder / ("best.toml" if done else "policy.toml")
    config.write(
        path, {"what": what, "params": params} | session.kind.robot.policy_file(session, policy)
    )
    session.kind.robot.show(session, _tried(session, state, history), policy, history, done)
    print(f"written: {path}")
    if done:
        print(
            f"all {total} {session.kind.robot.turn}s are told; best return "
            f"{float(state.best_score):.6g}"
        )
    else:
        print(f"then: adaptsim robot record FILE --dir {args.dir}")
    return stands(session) | {"done": done, "params": params, "policy": str(path)}


def record(args: argparse.Namespace, session: RobotSession) -> None:
    """Take what was measured."""
    from adaptsim_jax.commands.adapt import number
    from adaptsim_jax.core.errors import BadInput

    before, history, total = _not_done(session)
    turn, path = session.kind.robot.turn, Path(args.what)
    digest = _digest(path)
    for earlier, trial in enumerate(history, 1):
        if digest is not None and trial.get("sha256") == digest:
            raise BadInput(
                f"{path}: was told already, as {turn} {earlier}; name the file of {turn} "
                f"{len(history) + 1}"
            )
    tried = _tried(session, before, history)
    trajectory = session.kind.robot.read(session, tried, path)
    state, info = session.loop.tell(before, trajectory)
    entry = {"file": str(path), "sha256": digest, "score": number(info.score)}
    for earlier, trial in enumerate(history, 1):
        if entry["score"] and trial.get("score") == entry["score"]:
            print(
                f"warning: {turn} {earlier} had the same return to the last digit: the same "
                "recording? then: adaptsim robot undo"
            )
            break
    after = [*history, entry | session.kind.robot.remember(session, tried, trajectory)]
    sessions.advance(session, (before, history), (state, after))
    best = ", the best so far" if bool(info.best) else ""
    print(f"{turn} {len(after)} of {total}: return {float(info.score):.6g}{best}")
    session.kind.robot.comment(session, tried, state, trajectory, len(after) >= total)


def failed(args: argparse.Namespace, session: RobotSession) -> None:
    """The robot could not finish: asked again, or without a return and its start given up, as the
    task says.
    """
    before, history, total = _not_done(session)
    turn = session.kind.robot.turn
    if session.kind.robot.again:
        print(
            f"{turn} {len(history) + 1} of {total} failed: nothing is recorded, and the same "
            f"{turn} is asked again"
        )
    else:
        state = session.loop.skip(before)
        given_up = int(state.told) - len(history)
        after = [
            *history,
            *(
                {"file": None, "sha256": None, "score": None, "failed": True}
                for _ in range(given_up)
            ),
        ]
        sessions.advance(session, (before, history), (state, after))
        if given_up > 1:
            rest = f"; with it {given_up - 1} more of the same start are given up"
        else:
            rest = ""
        print(f"{turn} {len(history) + 1} of {total} failed: no return{rest}")


def undo(args: argparse.Namespace, session: RobotSession) -> None:
    """Take the last record back; the session is then as it was before it, to the same bits."""
    import shutil

    from adaptsim_jax.core.errors import BadInput

    _, history = sessions.load(session)
    kept = [path for path in (session.folder / UNDO).glob("*") if path.name.isdigit()]
    kept = [path for path in kept if int(path.name) < len(history)]
    if not kept:
        if not history:
            what = "nothing was recorded yet"
        else:
            what = "it was recorded by a version that kept no way back"
        raise BadInput(f"{session.folder}: no record can be taken back: {what}")
    last = max(kept, key=lambda path: int(path.name))
    state, earlier = sessions.load(session, last)
    sessions.save(session, state, earlier)
    shutil.rmtree(last)
    (session.folder / "best.toml").unlink(missing_ok=True)
    gone = history[len(earlier)]
    what = gone["file"] or "a failure"
    print(f"taken back: {what}, of {session.kind.robot.turn} {len(earlier) + 1}")


def _not_done(session: RobotSession) -> tuple[Any, list[Table], int]:
    """State, history and number of turns. BadInput where all are told."""
    from adaptsim_jax.core.errors import BadInput

    state, history = sessions.load(session)
    total = session.loop.trials(state)
    if len(history) >= total:
        what = f"all {total} {session.kind.robot.turn}s are told"
        raise BadInput(f"{session.folder}: {what}; 'robot new' starts another session")
    return state, history, total


def _tried(session: RobotSession, state: Any, history: list[Table]) -> Any:
    """The state with its policy as the coming turn makes its trials."""
    return state._replace(policy=session.kind.robot.tried(session, state.policy, history))


def _digest(path: Path) -> str | None:
    """Of the file's bytes; where it cannot be read, reading it says why."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return None
