"""Members of a sweep, and the parallel trajectories of each, shared out among devices of one
machine, or of many with one program.

The mesh has two axes. Along `members` each device runs members of its own and never waits for
another. Where there are fewer members than devices, the devices along `trajectories` run
trajectories of the same member, exchange what came of them, and then all learn from all, so that
the numbers are those of one device.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as P

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
    along = max(d for d in range(1, devices + 1) if devices % d == 0 and d <= max(members, 1))
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


def over_members(function: Callable, mesh: Mesh, batched: tuple[bool, ...]) -> Callable:
    """`function` of one member, compiled for all members of a batch: arguments with `batched` have
    leaves `[S, ...]`, the others are the same for all; `S` is a multiple of the devices along
    `members`. Results have leaves `[S, ...]`.
    """
    specs = tuple(P(MEMBERS) if b else P() for b in batched)
    many = jax.vmap(function, in_axes=tuple(0 if b else None for b in batched))
    # what lies along `trajectories` is equal on all of its devices, which the checker cannot know
    return jax.jit(
        jax.shard_map(many, mesh=mesh, in_specs=specs, out_specs=P(MEMBERS), check_vma=False)
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
