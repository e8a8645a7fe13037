"""`adaptsim robot`: Phase 2 one trial at a time, with its state on disk between calls."""

from __future__ import annotations

import argparse
import hashlib
import importlib
from pathlib import Path
from typing import Any, NamedTuple

EXAMPLES = """
  adaptsim robot new runs/a --dir robot          start from a trained run
  adaptsim robot next --dir robot                which policy to run on the robot now
  adaptsim robot record trial.csv --dir robot    what was measured; then `next` again

RUN is the folder of `adaptsim train`. FILE is a CSV (or npz) of one trial, from the moment of letting go: columns time [s],
q1, q2 [rad, zero upright], tau1, tau2 [N m], and v1, v2 [rad/s] where measured. `next` says the policy each time, and
the best one when all trials are told.
"""
STEPS = ("new", "next", "record")
SESSION = "robot.toml"
HOW = {
    "pendulum": "let go hanging straight down (q1 = -pi, zero upright); for 2.5 s, {law}\n"
    "write a CSV with columns time, q1, q2, tau1, tau2 (v1, v2 where measured) in s, rad, N m"
}
GAIN = "torque = -gain @ [q1, q2, v1, v2];"
CONTROLLER = """every 5 ms, the torque that this policy's controller says (it is more than its gain):
  from adaptsim_jax.tasks.pendulum_controller import read_controller
  controller = read_controller({folder!r})
  torque = controller([q1, q2, v1, v2], t)   # rad with zero upright, rad/s, s since the start; N m"""


class Session(NamedTuple):
    """A session on disk: where it is, how it was started, and the learned adaptation policy at work."""

    folder: Path
    table: dict[str, Any]
    trained: Any
    loop: Any


def arguments(parser: argparse.ArgumentParser) -> None:
    from adaptsim_jax.commands.common import positive

    parser.add_argument("step", metavar="new|next|record", help="start, ask, tell")
    parser.add_argument("what", nargs="?", metavar="RUN|FILE", help="new: a trained run; record: a CSV or npz")
    parser.add_argument("--dir", required=True, metavar="DIR", help="where the state is kept between calls")
    parser.add_argument("--starts", type=positive, default=2, metavar="N", help="new: initial distributions (2)")
    parser.add_argument("--iterations", type=positive, default=10, metavar="I", help="new: adaptation steps (10)")


def run(args: argparse.Namespace) -> int:
    """One step of ask/tell adaptation."""
    from adaptsim_jax.config import pick
    from adaptsim_jax.errors import BadInput

    step = pick("step", args.step, STEPS)
    if step != "next" and args.what is None:
        raise BadInput(f"robot {step}: {'RUN' if step == 'new' else 'FILE'} is missing; see 'adaptsim robot --help'")
    {"new": new, "next": ask, "record": record}[step](args)
    return 0


def new(args: argparse.Namespace) -> None:
    """Start a session in an empty folder."""
    import jax

    from adaptsim_jax import config, files
    from adaptsim_jax.adapt.phase2 import draw_starts
    from adaptsim_jax.adapt.training import archive_size
    from adaptsim_jax.errors import BadInput

    folder = Path(args.dir)
    if (folder / SESSION).exists():
        raise BadInput(f"{folder}: holds a session already; go on with 'adaptsim robot next --dir {folder}'")
    table = {
        "schema": 1, "run": str(Path(args.what).resolve()), "seed": args.seed,
        "starts": args.starts, "iterations": args.iterations,
    }  # fmt: skip
    session = _session(folder, table)
    trained = session.trained
    name = trained.phase1.task.name
    if name not in HOW:
        raise BadInput(
            f"{args.what}: a run of task '{name}'; robot takes runs of {', '.join(HOW)} in this version. "
            f"For {name} use 'adaptsim adapt', or from Python adaptsim_jax.adapt.asktell with recorded trajectories"
        )
    files.output_folder(folder)
    start_key, key = jax.random.split(jax.random.key(args.seed))
    used = archive_size(trained.phase1, trained.rounds)
    starts = draw_starts(start_key, trained.state.archive, used, args.starts)
    _save(session, session.loop.init(key, starts), [])
    # written last: a folder with this file holds a whole session
    config.write(folder / SESSION, table)
    print(f"session of {args.starts * (args.iterations + 1)} trials in {folder}")
    ask(args)


def ask(args: argparse.Namespace) -> None:
    """Print the policy to run now, and write it to policy.toml; when all is told, the best one."""
    from adaptsim_jax import config
    from adaptsim_jax.commands.adapt import policy_table

    session = _open(Path(args.dir))
    state, history = _load(session)
    task, total = session.trained.phase1.task, session.loop.trials(state)
    done = len(history) >= total
    mean, policy = (state.best_mean, state.best_policy) if done else (state.mean, state.policy)
    params = dict(zip(task.space.names, map(float, task.space.physical(mean)), strict=True))
    what = "best policy" if done else f"trial {len(history) + 1} of {total}"
    print(f"{what}: trained at {', '.join(f'{name} {value:.4g}' for name, value in params.items())}")
    model = _task_options(session).get("model")
    for name, value in policy_table(policy).items():
        # a solver's code of 0 says nothing; the rest of a mended policy is for its controller, not for people
        if name == "gain" or (model is None and value != 0):
            print(f"  {name} = {_digits(value)}")
    path = session.folder / ("best.toml" if done else "policy.toml")
    config.write(path, {"what": what, "params": params, "policy": policy_table(policy)})
    print(f"written: {path}")
    if done:
        print(f"all {total} trials are told; best return {float(state.best_score):.6g}")
    else:
        print(_how(session, model))
        print(f"then: adaptsim robot record FILE --dir {args.dir}")


def _digits(value: Any) -> str:
    """Six digits for the eye; policy.toml has them all."""
    return f"[{', '.join(map(_digits, value))}]" if isinstance(value, list) else f"{value:.6g}"


def _how(session: Session, model: dict[str, Any] | None) -> str:
    """What to do on the robot; a mended model's controller needs the model beside the policy."""
    from adaptsim_jax import config

    if model is None:
        return HOW[session.trained.phase1.task.name].format(law=GAIN)
    config.write(session.folder / "model.toml", model)
    return HOW[session.trained.phase1.task.name].format(law=CONTROLLER.format(folder=str(session.folder)))


def record(args: argparse.Namespace) -> None:
    """Take a measured trial."""
    from adaptsim_jax.closeloop.table import read_table
    from adaptsim_jax.commands.adapt import number
    from adaptsim_jax.errors import BadInput

    session = _open(Path(args.dir))
    state, history = _load(session)
    total = session.loop.trials(state)
    if len(history) >= total:
        raise BadInput(f"{session.folder}: all {total} trials are told; 'robot new' starts another session")
    trained = session.trained
    measured = importlib.import_module(f"adaptsim_jax.tasks.{trained.phase1.task.name}_measured")
    path = Path(args.what)
    table = read_table(path, measured.COLUMNS)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    for before, trial in enumerate(history, 1):
        if trial["sha256"] == digest:
            raise BadInput(f"{path}: was told already, as trial {before}; name the file of trial {len(history) + 1}")
    observation = _task_options(session).get("observation", "full")
    trajectory = measured.measured_trajectory(table.columns, str(path), observation)
    state, info = session.loop.tell(state, trajectory)
    history.append({"file": str(path), "sha256": digest, "score": number(info.score)})
    _save(session, state, history)
    best = ", the best so far" if bool(info.best) else ""
    print(f"trial {len(history)} of {total}: return {float(info.score):.6g}{best}")
    print(f"next: adaptsim robot next --dir {args.dir}")


def _open(folder: Path) -> Session:
    from adaptsim_jax import config
    from adaptsim_jax.errors import BadInput

    if not (folder / SESSION).exists():
        raise BadInput(f"{folder}: no session here; start one with 'adaptsim robot new RUN --dir {folder}'")
    table = config.read(folder / SESSION)
    for name, kind in {"schema": int, "run": str, "seed": int, "starts": int, "iterations": int}.items():
        if type(table.get(name)) is not kind:
            raise BadInput(f"{folder / SESSION}: key '{name}' is missing or no {kind.__name__}; restore the file")
    return _session(folder, table)


def _session(folder: Path, table: dict[str, Any]) -> Session:
    from adaptsim_jax.adapt.asktell import make_ask_tell
    from adaptsim_jax.adapt.training import load_run
    from adaptsim_jax.store import RunFolder

    trained = load_run(RunFolder.open(table["run"]))
    phase1 = trained.phase1
    weights, delta = trained.state.learner.target, float(trained.hyper.delta)
    loop = make_ask_tell(phase1.task, phase1.bdq, weights, iterations=table["iterations"], delta=delta)
    return Session(folder, table, trained, loop)


def _task_options(session: Session) -> dict[str, Any]:
    from adaptsim_jax.store import RunFolder

    return RunFolder.open(session.table["run"]).config.get("task", {})


def _save(session: Session, state: Any, history: list[dict[str, Any]]) -> None:
    from adaptsim_jax import config, store

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

    from adaptsim_jax import config, store
    from adaptsim_jax.adapt.phase1 import Archive
    from adaptsim_jax.errors import BadInput

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
