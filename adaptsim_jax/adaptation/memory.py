"""Memory that runs of Phase 1 take side by side, and how many of them the machine has room for."""

import os
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from adaptsim_jax.adaptation.phase1 import make_phase1
from adaptsim_jax.adaptation.phase1_config import Phase1Config
from adaptsim_jax.tasks.base import Task

# of the free memory that a batch may take: the estimate leaves out what the compiler keeps besides
SHARE = 0.5


def seeds_at_once(task: Task, config: Phase1Config, count: int) -> int:
    """How many of `count` runs go side by side in one program: what fits into memory on an
    accelerator, on a CPU one, where more are no faster (`benchmarks/phase1.py --seeds`).
    """
    if jax.default_backend() == "cpu":
        return 1
    return max(1, min(count, int(SHARE * free_memory() // member_bytes(task, config))))


def member_bytes(task: Task, config: Phase1Config) -> int:
    """Bytes that a member takes while it is trained, by the shapes of what it holds. That is
    its state twice (before and after a round), a round's trajectories, and the batches that a round
    learns from.
    """
    phase1 = make_phase1(task, config)
    state = jax.eval_shape(phase1.init, jax.random.key(0))
    item = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[1:], x.dtype), state.replay)
    policy = jax.eval_shape(task.init_policy, jax.random.key(0))
    visits = config.parallel * (config.horizon + 1)
    return (
        2 * _bytes(state)
        + config.updates * config.batch * _bytes(item)
        + visits * (_bytes(policy) + _bytes(item))
    )


def _bytes(tree: Any) -> int:
    return sum(int(x.size) * jnp.dtype(_plain(x.dtype)).itemsize for x in jax.tree.leaves(tree))


def _plain(dtype: Any) -> Any:
    if jnp.issubdtype(dtype, jax.dtypes.prng_key):
        return jnp.uint64
    return dtype


def free_memory() -> int:
    """Bytes that a batch could have: of the accelerators that this program drives, else of the
    machine.
    """
    if jax.default_backend() != "cpu":
        stats = [d.memory_stats() for d in jax.local_devices()]
    else:
        stats = []
    limits = [
        s["bytes_limit"] - s.get("bytes_in_use", 0) for s in stats if s and "bytes_limit" in s
    ]
    if limits:
        return sum(limits)
    found = Path("/proc/meminfo")
    for line in found.read_text().splitlines() if found.exists() else ():
        if line.startswith("MemAvailable:"):
            return min(int(line.split()[1]) * 1024, _limit_of_container())
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2


def _limit_of_container() -> int:
    try:
        return int(Path("/sys/fs/cgroup/memory.max").read_text())
    except (OSError, ValueError):
        return 2**62
