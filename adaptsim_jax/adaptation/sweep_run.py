"""A whole sweep: batch after batch into its folder, taken up where it was left, failed members kept
with their reasons.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.adaptation import sweep_devices as devices
from adaptsim_jax.adaptation.sweep_batch import Programs, halved, make_programs, run_batch
from adaptsim_jax.adaptation.sweep_folder import SweepFolder
from adaptsim_jax.adaptation.sweep_plan import Batch
from adaptsim_jax.adaptation.sweep_spec import Member, Sweep
from adaptsim_jax.core import config as configs
from adaptsim_jax.core.files import without_nan
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


def members_of(sweep: Sweep, folder: SweepFolder, batch: Batch) -> list[Member]:
    return [
        sweep.members[i] for i in folder.plan.groups[batch.group].members[batch.first : batch.last]
    ]


def _rounds(sweep: Sweep, folder: SweepFolder, batch: Batch) -> int:
    return sum(m.config.phase1.rounds for m in members_of(sweep, folder, batch))


class Held:
    """The programs of the group that is being run, so that batches of one group share them."""

    def __init__(self, sweep: Sweep, folder: SweepFolder):
        self.sweep, self.folder = sweep, folder
        self.group, self.programs = -1, None

    def programs_of(self, batch: Batch) -> Programs:
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
    along = max(d for d in range(1, have + 1) if group.width % d == 0)
    return devices.Split(along, 1)


def rows_of(
    held: Held, batch: Batch, report: Callable[[int, str], None], save_after: float
) -> list[dict[str, Any]]:
    """A row for each member of the batch, as `results.json` has it; run folders of members are left
    where `keep` asks for them.
    """
    sweep, folder = held.sweep, held.folder
    members = members_of(sweep, folder, batch)

    def run(some: list[Member]) -> list[dict[str, Any]]:
        programs = held.programs_of(batch)
        work = folder.work(batch, some)
        found, state = run_batch(
            programs, sweep.spec, some, work, progress=report, save_after=save_after
        )
        if sweep.spec.keep and devices.first():
            for i, member in enumerate(some):
                _leave_run(
                    programs, sweep, folder, member, jax.tree.map(lambda x, i=i: x[i], state)
                )
        return [_row(sweep, member, each) for member, each in zip(some, found, strict=True)]

    return halved(members, run, failed_row)


def failed_row(member: Member, reason: str) -> dict[str, Any]:
    """The row of a member that came to nothing."""
    return _head(member) | {"status": "failed", "reason": reason}


def _head(member: Member) -> dict[str, Any]:
    return {"member": member.index, "seed": member.config.seed, "values": member.values}


def _row(sweep: Sweep, member: Member, found: dict[str, Any]) -> dict[str, Any]:
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
    programs: Programs, sweep: Sweep, folder: SweepFolder, member: Member, state: Any
) -> None:
    """The member as a run folder that `adaptsim adapt` reads, unless it is there whole."""
    path = folder.path / "runs" / f"{member.index:05d}"
    if (path / CHECKPOINT / "manifest.json").exists():
        return
    (path / "config.toml").unlink(missing_ok=True)  # of a process that was killed in between
    run = RunFolder.create(Path(path), configs.to_table(member.config), task=sweep.spec.task)
    key = jax.random.wrap_key_data(jnp.asarray(state.key))
    run.save(state._replace(key=key), programs.phase1.config.rounds)
