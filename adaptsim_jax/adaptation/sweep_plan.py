"""How a sweep is cut up: groups that share a program, batches of them that fit into memory, devices
that a batch is split over.
"""

import math
import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as P

from adaptsim_jax.adaptation.memory import SHARE, free_memory, member_bytes
from adaptsim_jax.adaptation.phase1_config import Phase1Hyper
from adaptsim_jax.adaptation.sweep_spec import Member, Sweep
from adaptsim_jax.core import config as configs
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.parallel import largest_divisor
from adaptsim_jax.tasks.registry import make_task

# ---------------------------------------------------------------- devices
#
# Members of a sweep, and the parallel trajectories of each, shared out among devices of one
# machine, or of many with one program.
#
# The mesh has two axes. Along `members` each device runs members of its own and never waits for
# another. Where there are fewer members than devices, the devices along `trajectories` run
# trajectories of the same member, exchange what came of them, and then all learn from all, so that
# the numbers are those of one device.

MEMBERS, TRAJECTORIES = "members", "trajectories"


class Split(NamedTuple):
    """How many devices lie along each axis of the mesh."""

    members: int
    trajectories: int


def choose_split(devices: int, members: int, parallel: int) -> Split:
    """Members first: as many devices along that axis as there are members for, the rest along
    `trajectories` if `parallel` of them (0: they cannot be shared out) divide evenly. Where they do
    not, members are padded with copies.
    """
    along = largest_divisor(min(members, devices), devices)
    rest = devices // along
    if parallel and parallel % rest == 0:
        return Split(along, rest)
    return Split(devices, 1)


def make_mesh(split: Split) -> Mesh:
    """The mesh over the devices that this program has, on other machines too."""
    wanted = split.members * split.trajectories
    return Mesh(np.array(jax.devices()[:wanted]).reshape(split), (MEMBERS, TRAJECTORIES))


def spread(split: Split) -> Callable:
    """What `make_phase1` maps trajectories with: each device along `trajectories` runs its share,
    then all have all of them.
    """
    if split.trajectories == 1:
        return jax.vmap

    def over(one):
        def run(keys):
            share = keys.shape[0] // split.trajectories
            mine = jax.lax.dynamic_slice_in_dim(
                keys, jax.lax.axis_index(TRAJECTORIES) * share, share
            )

            def together(x):
                return jax.lax.all_gather(x, TRAJECTORIES, tiled=True)

            return jax.tree.map(together, jax.vmap(one)(mine))

        return run

    return over


def over_members(
    function: Callable, mesh: Mesh, batched: tuple[bool, ...], donated: tuple[int, ...] = ()
) -> Callable:
    """`function` of one member, compiled for all members of a batch: arguments with `batched` have
    leaves `[S, ...]`, the others are the same for all; `S` is a multiple of the devices along
    `members`. Results have leaves `[S, ...]`. donated: Arguments whose memory the results take.
    """
    specs = tuple(P(MEMBERS) if b else P() for b in batched)
    many = jax.vmap(function, in_axes=tuple(0 if b else None for b in batched))
    # what lies along `trajectories` is equal on all of its devices, which the checker cannot know
    return jax.jit(
        jax.shard_map(many, mesh=mesh, in_specs=specs, out_specs=P(MEMBERS), check_vma=False),
        donate_argnums=donated,
    )


def put(tree: Any, mesh: Mesh, batched: bool = True) -> Any:
    """Host arrays onto the mesh, split along the first axis if `batched`. Each program of many must
    hold the same arrays.
    """
    sharding = NamedSharding(mesh, P(MEMBERS) if batched else P())

    def one(x):
        x = np.asarray(x)
        return jax.make_array_from_callback(x.shape, sharding, lambda index: x[index])

    return jax.tree.map(one, tree)


def fetch(tree: Any) -> Any:
    """Whole host arrays of what lies on devices, of other machines too; all programs must ask at
    once.
    """
    if jax.process_count() == 1:
        return jax.tree.map(np.asarray, tree)
    from jax.experimental import multihost_utils

    return jax.tree.map(np.asarray, multihost_utils.process_allgather(tree, tiled=True))


def agreed(flag: bool) -> bool:
    """What the first program says; all must ask at once."""
    if jax.process_count() == 1:
        return flag
    from jax.experimental import multihost_utils

    return bool(multihost_utils.broadcast_one_to_all(jnp.int32(flag)))


def first() -> bool:
    """Whether this program is the one that writes."""
    return jax.process_index() == 0


def join(coordinator: str | None, processes: int | None, index: int | None) -> None:
    """Become one of `processes` programs that run a sweep together. Without arguments what SLURM
    (or another launcher that JAX knows) says is taken. To be called before anything is computed.
    """
    jax.distributed.initialize(coordinator, processes, index)


PER_CORE = (
    8  # members at once on a core: more gain nothing there, and checkpoints and progress are rarer
)


class MemberBatch(NamedTuple):
    """Members `first` to `last` (not included) of group `group`, in the group's order. number: Of
    the batch in the sweep.
    """

    number: int
    group: int
    first: int
    last: int

    @property
    def name(self) -> str:
        return f"part-{self.number:05d}"


class MemberGroup(NamedTuple):
    """Members (their indices) that differ in seeds and traced values alone. width: How many at
    once. member_bytes: Of memory that one takes, as estimated. split: Of the devices.
    """

    members: tuple[int, ...]
    width: int
    member_bytes: int
    split: Split


class SweepPlan(NamedTuple):
    groups: tuple[MemberGroup, ...]
    batches: tuple[MemberBatch, ...]


def grouped(sweep: Sweep) -> list[list[Member]]:
    """Members that share a program, groups in the order of their first member."""
    groups: dict[str, list[Member]] = {}
    for member in sweep.members:
        static = replace(member.config, seed=0, hyper=Phase1Hyper())
        groups.setdefault(configs.digest(configs.to_table(static)), []).append(member)
    return list(groups.values())


def make_plan(
    sweep: Sweep, *, devices: int, at_once: int | None = None, memory: int | None = None
) -> SweepPlan:
    """Batches for `devices` devices of this machine (of all machines together). at_once: Members a
    batch, where given. memory: Bytes free on each machine, by default as found. BadInput where not
    even one member fits.
    """
    memory = free_memory() if memory is None else memory
    groups, batches = [], []
    for members in grouped(sweep):
        config = members[0].config
        task = make_task(sweep.spec.task, config.task, "task")
        each = member_bytes(task, config.phase1)
        fits = int(SHARE * memory // each) * max(1, jax.process_count())
        if fits < 1:
            raise BadInput(
                f"a member of this sweep takes about {each / 1e9:.1f} GB and {memory / 1e9:.1f} GB "
                "are free; give a smaller phase1.capacity, phase1.archive or phase1.parallel"
            )
        if config.phase1.reuse.threshold > 0:
            shareable = 0
        else:
            shareable = config.phase1.parallel
        limit = at_once or min(fits, _useful(devices))
        split = choose_split(devices, min(limit, len(members)), shareable)
        width = _width(len(members), limit, split.members)
        groups.append(MemberGroup(tuple(m.index for m in members), width, each, split))
        for first in range(0, len(members), width):
            last = min(first + width, len(members))
            batches.append(MemberBatch(len(batches), len(groups) - 1, first, last))
    return SweepPlan(tuple(groups), tuple(batches))


def _useful(devices: int) -> int:
    if jax.default_backend() != "cpu":
        return 10**9
    return PER_CORE * max(devices, os.cpu_count() or 1)


def _width(count: int, limit: int, along: int) -> int:
    """Even batches of at most `limit`, rounded up to a multiple of the devices along them."""
    batches = math.ceil(count / min(limit, count))
    return padded(math.ceil(count / batches), along)


def padded(count: int, along: int) -> int:
    """`count` members, rounded up to a multiple of the devices along them."""
    return math.ceil(count / along) * along


def to_table(plan: SweepPlan) -> Table:
    """The plan as JSON has it."""
    return {"groups": [group._asdict() for group in plan.groups], "batches": plan.batches}


def from_table(table: Table) -> SweepPlan:
    groups = [
        MemberGroup(**g | {"members": tuple(g["members"]), "split": Split(*g["split"])})
        for g in table["groups"]
    ]
    return SweepPlan(tuple(groups), tuple(MemberBatch(*b) for b in table["batches"]))


def described(plan: SweepPlan) -> Iterator[str]:
    """A line for each group, for a person."""
    for i, group in enumerate(plan.groups):
        size = group.member_bytes / 1e6
        count = sum(b.group == i for b in plan.batches)
        batches = f"{count} batch{'es' * (count != 1)} of {group.width}"
        if max(group.split) > 1:
            over = f", over {group.split.members} x {group.split.trajectories} devices"
        else:
            over = ""
        yield (
            f"program {i + 1}: {len(group.members)} members, {batches}{over}; about {size:.0f} MB "
            f"a member, {size * group.width / 1e3:.2f} GB a batch"
        )
