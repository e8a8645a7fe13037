"""`adaptsim robot`: Phase 2 one trial at a time, with its state on disk between calls."""

from __future__ import annotations

import argparse
import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from adaptsim_jax.core.store import RunFolder

EXAMPLES = """
  adaptsim robot new runs/a --dir robot          start from a trained run
  adaptsim robot next --dir robot                what to run on the robot now
  adaptsim robot record trial.csv --dir robot    what was measured; then `next` again

RUN is the folder of `adaptsim train`. `next` says the policy or the actions each time, and the best ones when all is told.
FILE, a CSV (or npz), of the pendulum: one trial, from the moment of letting go: columns time [s], q1, q2 [rad, zero
upright], tau1, tau2 [N m], and v1, v2 [rad/s] where measured. Of the push: all pushes that `next` wrote to actions.csv:
columns trial, time [s since the arm's start], x, y [m, arm's base frame] of the bottle. Of scooping likewise: trial, time, x, y of
the piece [m, x along the spatula's way], and on, 1 where it lies on the spatula.
"""
STEPS = ("new", "next", "record")
SESSION = "robot.toml"


class Session(NamedTuple):
    """A session on disk: where it is, how it was started, the learned adaptation policy at work, the task's options, and
    what speaks for the task (`task_parts.RobotPart`)."""

    folder: Path
    table: dict[str, Any]
    trained: Any
    loop: Any
    options: dict[str, Any]
    part: Any


def arguments(parser: argparse.ArgumentParser) -> None:
    from adaptsim_jax.commands.common import positive

    parser.add_argument("step", metavar="new|next|record", help="start, ask, tell")
    parser.add_argument("what", nargs="?", metavar="RUN|FILE", help="new: a trained run; record: a CSV or npz")
    parser.add_argument("--dir", required=True, metavar="DIR", help="where the state is kept between calls")
    parser.add_argument("--starts", type=positive, default=2, metavar="N", help="new: initial distributions (2)")
    parser.add_argument("--iterations", type=positive, default=10, metavar="I", help="new: adaptation steps (10)")


def run(args: argparse.Namespace) -> int:
    """One step of ask/tell adaptation."""
    from adaptsim_jax.core.config import pick
    from adaptsim_jax.core.errors import BadInput

    step = pick("step", args.step, STEPS)
    if step != "next" and args.what is None:
        raise BadInput(f"robot {step}: {'RUN' if step == 'new' else 'FILE'} is missing; see 'adaptsim robot --help'")
    {"new": new, "next": ask, "record": record}[step](args)
    return 0


def new(args: argparse.Namespace) -> None:
    """Start a session in an empty folder."""
    import jax

    from adaptsim_jax.adaptation.phase2 import draw_starts
    from adaptsim_jax.adaptation.training import archive_size
    from adaptsim_jax.core import config, files
    from adaptsim_jax.core.errors import BadInput

    folder = Path(args.dir)
    if (folder / SESSION).exists():
        raise BadInput(f"{folder}: holds a session already; go on with 'adaptsim robot next --dir {folder}'")
    path = str(Path(args.what).resolve())
    table = {
        "schema": 1, "run": path, "seed": args.seed, "starts": args.starts, "iterations": args.iterations,
        "trained": _identity(_run_of(path)),
    }  # fmt: skip
    session = _session(folder, table)
    trained = session.trained
    files.output_folder(folder)
    start_key, key = jax.random.split(jax.random.key(args.seed))
    used = archive_size(trained.phase1, trained.rounds)
    starts = draw_starts(start_key, trained.state.archive, used, args.starts)
    _save(session, session.loop.init(key, starts), [])
    # written last: a folder with this file holds a whole session
    config.write(folder / SESSION, table)
    print(f"{session.part.opened(session, args.starts * (args.iterations + 1))} in {folder}")
    ask(args)


def ask(args: argparse.Namespace) -> None:
    """Say and write what to run now; when all is told, the best policy."""
    from adaptsim_jax.core import config

    session = _open(Path(args.dir))
    state, history = _load(session)
    task, total = session.trained.phase1.task, session.loop.trials(state)
    done = len(history) >= total
    mean, policy = (state.best_mean, state.best_policy) if done else (state.mean, state.policy)
    policy = session.part.deployed(session, policy, history)
    params = dict(zip(task.space.names, map(float, task.space.physical(mean)), strict=True))
    what = "best policy" if done else f"{session.part.turn} {len(history) + 1} of {total}"
    print(f"{what}: trained at {', '.join(f'{name} {value:.4g}' for name, value in params.items())}")
    path = session.folder / ("best.toml" if done else "policy.toml")
    config.write(path, {"what": what, "params": params} | session.part.policy_file(session, policy))
    session.part.show(session, _tried(session, state, history), policy, history, done)
    print(f"written: {path}")
    if done:
        print(f"all {total} {session.part.turn}s are told; best return {float(state.best_score):.6g}")
    else:
        print(f"then: adaptsim robot record FILE --dir {args.dir}")


def record(args: argparse.Namespace) -> None:
    """Take what was measured."""
    from adaptsim_jax.commands.adapt import number
    from adaptsim_jax.core.errors import BadInput

    session = _open(Path(args.dir))
    before, history = _load(session)
    total, turn = session.loop.trials(before), session.part.turn
    if len(history) >= total:
        raise BadInput(f"{session.folder}: all {total} {turn}s are told; 'robot new' starts another session")
    path = Path(args.what)
    digest = _digest(path)
    for earlier, trial in enumerate(history, 1):
        if trial["sha256"] == digest:
            raise BadInput(f"{path}: was told already, as {turn} {earlier}; name the file of {turn} {len(history) + 1}")
    tried = _tried(session, before, history)
    trajectory = session.part.read(session, tried, path)
    state, info = session.loop.tell(before, trajectory)
    entry = {"file": str(path), "sha256": digest, "score": number(info.score)}
    history.append(entry | session.part.remember(session, tried, trajectory))
    _save(session, state, history)
    best = ", the best so far" if bool(info.best) else ""
    print(f"{turn} {len(history)} of {total}: return {float(info.score):.6g}{best}")
    session.part.told(session, tried, state, trajectory, len(history) >= total)
    print(f"next: adaptsim robot next --dir {args.dir}")


def _tried(session: Session, state: Any, history: list[dict[str, Any]]) -> Any:
    """The state with its policy as the coming turn makes its trials."""
    return state._replace(policy=session.part.tried(session, state.policy, history))


def _digest(path: Path) -> str | None:
    """Of the file's bytes; where it cannot be read, reading it says why."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return None


def _open(folder: Path) -> Session:
    from adaptsim_jax.core import config
    from adaptsim_jax.core.errors import BadInput

    if not (folder / SESSION).exists():
        raise BadInput(f"{folder}: no session here; start one with 'adaptsim robot new RUN --dir {folder}'")
    table = config.read(folder / SESSION)
    for name, kind in {"schema": int, "run": str, "seed": int, "starts": int, "iterations": int}.items():
        if type(table.get(name)) is not kind:
            raise BadInput(f"{folder / SESSION}: key '{name}' is missing or no {kind.__name__}; restore the file")
    return _session(folder, table)


def _run_of(path: str) -> RunFolder:
    """The run at `path`, of a task that robots are for."""
    from adaptsim_jax.commands.task_parts import ROBOT
    from adaptsim_jax.core.errors import BadInput
    from adaptsim_jax.core.store import RunFolder

    run = RunFolder.open(path)
    if run.task not in ROBOT:
        raise BadInput(
            f"{path}: a run of task '{run.task}'; robot takes runs of {', '.join(ROBOT)} in this version. For "
            f"{run.task} use 'adaptsim adapt', or from Python adaptsim_jax.adaptation.asktell with recorded trajectories"
        )
    return run


def _identity(run: RunFolder) -> dict[str, Any]:
    """Which adaptation policy the run holds now: its checkpoint's step and hashes."""
    from adaptsim_jax.core.store import read_manifest

    manifest = read_manifest(run.checkpoint)
    return {name: manifest[name] for name in ("step", "sha256", "config_hash")}


def _check_same(run: RunFolder, table: dict[str, Any], folder: Path) -> None:
    """BadInput where the run's checkpoint is not the one that the session began with. Older sessions do not say which it was."""
    from adaptsim_jax.core.errors import BadInput

    began, now = table.get("trained"), _identity(run)
    if began is not None and began != now:
        was = began.get("step") if isinstance(began, dict) else began
        raise BadInput(
            f"{run.path}: was trained on, or anew, since the session in {folder} began (checkpoint of round {was} then, another "
            f"of round {now['step']} now); put that checkpoint back, or start another session with 'adaptsim robot new'"
        )


def _session(folder: Path, table: dict[str, Any]) -> Session:
    from adaptsim_jax.adaptation.asktell import make_ask_tell
    from adaptsim_jax.adaptation.training import load_run
    from adaptsim_jax.commands.task_parts import robot_part

    run = _run_of(table["run"])
    trained = load_run(run)
    _check_same(run, table, folder)  # after the load, so that what was loaded is what is checked
    phase1 = trained.phase1
    weights, sizes = trained.state.learner.target, {k: float(getattr(trained.hyper, k)) for k in ("delta", "shrink")}
    loop = make_ask_tell(phase1.task, phase1.bdq, weights, iterations=table["iterations"], **sizes)
    return Session(folder, table, trained, loop, run.config.get("task", {}), robot_part(run.task))


def _save(session: Session, state: Any, history: list[dict[str, Any]]) -> None:
    from adaptsim_jax.core import config, store

    store.save_checkpoint(
        session.folder / store.CHECKPOINT,
        state,
        task=session.trained.phase1.task.name,
        step=len(history),
        config_hash=config.digest(session.table),
        extra={"history": history},
    )


def _load(session: Session) -> tuple[Any, list[dict[str, Any]]]:
    import jax
    import jax.numpy as jnp

    from adaptsim_jax.adaptation.phase1 import Archive
    from adaptsim_jax.core import config, store
    from adaptsim_jax.core.errors import BadInput

    task = session.trained.phase1.task
    folder = session.folder / store.CHECKPOINT
    if store.read_manifest(folder)["config_hash"] != config.digest(session.table):
        raise BadInput(f"{session.folder / SESSION}: was changed since the session began; restore the file")

    def like(key):
        count = session.table["starts"]
        policy = jax.vmap(task.init_policy)(jax.random.split(key, count))
        return session.loop.init(key, Archive(jnp.zeros((count, task.space.dim)), policy))

    state, _ = store.load_checkpoint(folder, jax.eval_shape(like, jax.random.key(0)), task=task.name)
    return state, store.read_manifest(folder)["extra"]["history"]
