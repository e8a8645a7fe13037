"""A whole sweep: batch after batch into its folder, taken up where it was left, failed members kept
with their reasons.

Batches may be shared out by Ray (the extra `[cluster]`): on this machine, or on a cluster that
shares the sweep's folder. A batch is one task of Ray's. Where its worker dies the task is run again,
from the batch's last checkpoint. Only this process writes parts, each once, so that nothing is lost
and nothing counts twice.
"""  # noqa: E501

import importlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.adaptation import sweep_plan as devices
from adaptsim_jax.adaptation.sweep_batch import Programs, halved, make_programs, run_batch
from adaptsim_jax.adaptation.sweep_folder import HEAD, SweepFolder, locked, write_results
from adaptsim_jax.adaptation.sweep_plan import MemberBatch
from adaptsim_jax.adaptation.sweep_read import read_sweep
from adaptsim_jax.adaptation.sweep_spec import Member, Sweep
from adaptsim_jax.adaptation.training import FOLDER, keep
from adaptsim_jax.core import config as configs
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.files import output_folder, without_nan
from adaptsim_jax.core.parallel import largest_divisor
from adaptsim_jax.core.progress import silent
from adaptsim_jax.core.store import CHECKPOINT, RunFolder


def run_sweep(
    sweep: Sweep, folder: SweepFolder, *, progress: Callable = silent, save_after: float = 30.0
) -> None:
    """All batches that are left, one after another in this process (and in all that joined it). The
    caller holds the folder.
    """
    total = sum(m.config.phase1.rounds for m in sweep.members)
    held = Held(sweep, folder)
    left = folder.left()
    done = total - sum(_rounds(sweep, folder, batch) for batch in left)
    for batch in left:
        count = batch.last - batch.first

        def report(rounds, note, done=done, count=count):
            progress(done + rounds * count, total, note)

        rows = rows_of(held, batch, report, save_after)
        if devices.first():
            folder.finish(batch, rows)
        done += _rounds(sweep, folder, batch)
        progress(done, total, "")


def sweep(
    spec: str | Path,
    out: str | Path,
    *,
    at_once: int | None = None,
    progress: Callable = silent,
    save_after: float = 30.0,
) -> Table:
    """A sweep in this process, as `adaptsim sweep SPEC.toml --out DIR --resume` runs it.

    Args:
        spec: The SPEC.toml: a task, seeds, targets, values by key.
        out: Its folder. A sweep that was stopped goes on, a finished one is read.
        at_once: Members side by side, by default what half of the free memory holds.
        progress: `(rounds done, of, note)`. save_after: s between checkpoints.

    Returns:
        The table of `results.json`, which is written with `results.csv`.

    Raises:
        BadInput: Names the line of `spec` at fault, or what differs from the sweep in `out`.
    """
    asked, path = read_sweep(spec), output_folder(Path(out))
    with locked(path):
        if not (path / HEAD).exists():
            plan = devices.make_plan(asked, devices=len(jax.devices()), at_once=at_once)
            SweepFolder.create(path, asked, plan)
        folder = SweepFolder.reopen(path, asked)
        run_sweep(asked, folder, progress=progress, save_after=save_after)
        return write_results(folder)


def members_of(sweep: Sweep, folder: SweepFolder, batch: MemberBatch) -> list[Member]:
    return [
        sweep.members[i] for i in folder.plan.groups[batch.group].members[batch.first : batch.last]
    ]


def _rounds(sweep: Sweep, folder: SweepFolder, batch: MemberBatch) -> int:
    return sum(m.config.phase1.rounds for m in members_of(sweep, folder, batch))


class Held:
    """The programs of the group that is being run, so that batches of one group share them."""

    def __init__(self, sweep: Sweep, folder: SweepFolder):
        self.sweep, self.folder = sweep, folder
        self.group, self.programs = -1, None

    def programs_of(self, batch: MemberBatch) -> Programs:
        if self.group != batch.group or self.programs is None:
            group = self.folder.plan.groups[batch.group]
            first = self.sweep.members[group.members[0]]
            self.programs = make_programs(self.sweep.spec, first, group.width, _split(group))
            self.group = batch.group
        return self.programs


def _split(group: Any) -> devices.Split:
    """The plan's split of devices, or one for those that are there now: results are then equal but
    for rounding.
    """
    have = len(jax.devices())
    if group.split.members * group.split.trajectories <= have:
        return group.split
    along = largest_divisor(have, group.width)
    return devices.Split(along, 1)


def rows_of(
    held: Held, batch: MemberBatch, report: Callable[[int, str], None], save_after: float
) -> list[Table]:
    """A row for each member of the batch, as `results.json` has it; run folders of members are left
    where `keep` asks for them.
    """
    sweep, folder = held.sweep, held.folder
    members = members_of(sweep, folder, batch)

    def run(some: list[Member]) -> list[Table]:
        programs = held.programs_of(batch)
        work = folder.work(batch, some)
        width = programs.width  # of a part of the batch, which did not fit whole, less
        if len(some) < len(members):
            width = devices.padded(len(some), programs.mesh.shape[devices.MEMBERS])
        found, state, prepared = run_batch(
            programs, sweep.spec, some, work, width=width, progress=report, save_after=save_after
        )
        if sweep.spec.keep and devices.first():
            for i, member in enumerate(some):
                own = jax.tree.map(lambda x, i=i: x[i], (state, prepared))
                _leave_run(programs, sweep, folder, member, *own)
        return [_row(sweep, member, each) for member, each in zip(some, found, strict=True)]

    return halved(members, run, failed_row)


def failed_row(member: Member, reason: str) -> Table:
    """The row of a member that came to nothing."""
    return _head(member) | {"status": "failed", "reason": reason}


def _head(member: Member) -> Table:
    return {"member": member.index, "seed": member.config.seed, "values": member.values}


def _row(sweep: Sweep, member: Member, found: Table) -> Table:
    reward = np.array(found["reward"])
    tail = reward[-max(1, len(reward) // 10) :]
    row = _head(member) | {
        "status": "done",
        "reason": "",
        "train_reward": float(tail.mean()),
        "curve": found["reward"],
    }
    if not found["whole"] or found["faulty"] >= 0:
        faulty = found["faulty"] + 1 if found["faulty"] >= 0 else len(reward)
        row |= {
            "status": "failed",
            "reason": f"the learner's loss or weights were not finite from round {faulty} on",
        }
    row["targets"] = {
        name: {
            "reward": found["best"][i],
            "params": found["params"][i],
            "rewards": found["rewards"][i],
        }
        for i, name in enumerate(sweep.spec.targets)
    }
    return without_nan(row)


def _leave_run(
    programs: Programs, sweep: Sweep, folder: SweepFolder, member: Member, state: Any, prepared: Any
) -> None:
    """The member as a run folder that `adaptsim adapt` reads, unless it is there whole."""
    path = folder.path / "runs" / f"{member.index:05d}"
    if (path / CHECKPOINT / "manifest.json").exists():
        return
    (path / "config.toml").unlink(missing_ok=True)  # of a process that was killed in between
    run = RunFolder.create(Path(path), configs.to_table(member.config), task=sweep.spec.task)
    task = programs.phase1.task
    if prepared != ():
        keep(path / FOLDER, task, prepared, member.config.seed)
    key = jax.random.wrap_key_data(jnp.asarray(state.key))
    run.save(state._replace(key=key), programs.phase1.config.rounds)


RETRIES = 5  # of a batch whose worker died


def run_on_ray(
    sweep: Sweep,
    folder: SweepFolder,
    address: str | None,
    *,
    progress: Callable = silent,
    save_after: float = 30.0,
    cpus: float = 1.0,
) -> None:
    """All batches that are left, `cpus` cores each. address: Of a cluster that runs (`auto`: of
    this machine's), else one is started here for as long as this lasts. BadInput where Ray is
    absent or does not answer.
    """
    ray = _ray()
    gpus = 1.0 if _ray_gpus(ray, address) else 0.0
    try:
        work = ray.remote(num_cpus=cpus, num_gpus=gpus, max_retries=RETRIES)(_ray_batch)
        shared = ray.put((sweep, str(folder.path.resolve())))
        waiting = {work.remote(shared, batch.number, save_after): batch for batch in folder.left()}
        count = len(folder.plan.batches)
        while waiting:
            ready, _ = ray.wait(list(waiting), num_returns=1)
            batch = waiting.pop(ready[0])
            folder.finish(batch, _ray_rows(ray, ready[0], sweep, folder, batch))
            progress(count - len(waiting), count, "")
    finally:
        ray.shutdown()


def _ray_rows(ray: Any, task: Any, sweep: Sweep, folder: SweepFolder, batch: Any) -> list[Table]:
    """What a task found; where its worker died again and again, its members are failed, with that
    reason.
    """

    try:
        return ray.get(task)
    except ray.exceptions.RayTaskError:
        raise  # bad input, or a fault of the program: the same anywhere
    except ray.exceptions.RayError as error:
        reason = f"the worker was lost {RETRIES + 1} times: {' '.join(str(error).split())[:200]}"
        return [failed_row(member, reason) for member in members_of(sweep, folder, batch)]


def _ray() -> Any:
    try:
        return importlib.import_module("ray")
    except ImportError:
        raise BadInput(
            "--ray: Ray is not installed; pip install 'adaptsim_jax[cluster]', or leave --ray out"
        ) from None


def _ray_gpus(ray: Any, address: str | None) -> int:
    """Join or start Ray; how many GPUs it has."""
    # a worker needs this process's settings (the compile cache among them), and none of its devices
    variables = {
        k: v
        for k, v in os.environ.items()
        if k.startswith(("JAX_", "PYTHONPATH", "OPENBLAS", "OMP", "XLA_FLAGS"))
    }
    variables["XLA_FLAGS"] = " ".join(
        w for w in variables.get("XLA_FLAGS", "").split() if "device_count" not in w
    )
    settings = {
        "log_to_driver": False,
        "configure_logging": False,
        "runtime_env": {"env_vars": variables},
    }
    try:
        ray.init(address=address, **settings) if address else ray.init(
            include_dashboard=False, **settings
        )
    except (ConnectionError, ValueError) as error:
        raise BadInput(
            f"--ray {address}: {' '.join(str(error).split())[:200]}; start it with `ray start "
            "--head`"
        ) from None
    except Exception as error:  # of no class of its own
        if "timed out during startup" not in str(error):
            raise
        raise BadInput(
            "--ray: Ray did not start within its 30 s; on a busy machine try again, with --resume"
        ) from None
    return int(ray.cluster_resources().get("GPU", 0))


def _ray_batch(shared: Any, number: int, save_after: float) -> list[Table]:
    """One batch, in a worker."""

    sweep, path = shared
    folder = SweepFolder.load(Path(path))
    return rows_of(
        Held(sweep, folder), folder.plan.batches[number], lambda rounds, note: None, save_after
    )
