"""Native pushes for compiled JAX code: processes that simulate, asked through `jax.pure_callback`.

The native engine asks JAX for the ground's friction at each step, which a callback must not do in
the process whose program waits for it. So each core has a process of its own that simulates
(`python -m adaptsim_jax.tasks.pushing.engines.served`), told what to do over a pipe in plain
numbers. They end when the pipe closes, which it does when the asking process is gone.
"""

from __future__ import annotations

import functools
import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import IO, Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.tasks.pushing import model as pushing
from adaptsim_jax.tasks.pushing.model import PushOptions

PIECE = 500
"""Pushes of one request: rows of more would fill memory, and the engine's blocks are smaller."""


def make_served(options: PushOptions, points: int) -> Any:
    """`push(params [4], action [2]) -> [points, 2]` m: the bottle in the native scene at even
    times, the last at the end; float32, not a number where the push failed. Pure: jit and vmap it;
    it has no derivative. Equal pushes of a call are made once.
    """
    pool = _pool(pushing.check_options(options), points, os.cpu_count() or 1)

    def push(params, action):
        shape = jax.ShapeDtypeStruct((points, 2), jnp.float32)
        return jax.pure_callback(pool.run, shape, params, action, vmap_method="broadcast_all")

    return push


def served_seconds() -> float:
    """Processor time of all serving processes of this one so far, which its own clock does not
    count.
    """
    return sum(pool.seconds for pool in _POOLS)


class _Pool:
    """Processes that simulate for this one; started with the first push that is asked for."""

    def __init__(self, options: PushOptions, points: int, count: int):
        self.options, self.points, self.count = options, points, count
        self.lock, self.processes, self.seconds = threading.Lock(), [], 0.0

    def run(self, params: Any, action: Any) -> np.ndarray:
        """`[..., 4], [..., 2] -> [..., points, 2]` float32."""
        params, action = np.asarray(params, np.float64), np.asarray(action, np.float64)
        asked = np.concatenate([params, action], -1)
        once, back = np.unique(asked.reshape(-1, 6), axis=0, return_inverse=True)
        # pushes of like speed step together in long stretches
        order = np.argsort(once[:, 4], kind="stable")
        size = max(1, min(PIECE, -(-len(once) // self.count)))
        pieces = [order[i : i + size] for i in range(0, len(once), size)]
        found = np.empty((len(once), self.points, 2), np.float32)
        with self.lock, ThreadPoolExecutor(self.count) as threads:
            self._start()

            def work(process):
                while pieces:
                    try:
                        mine = pieces.pop()
                    except IndexError:  # another was faster
                        return
                    found[mine] = self._ask(process, once[mine])

            list(threads.map(work, self.processes))
        return found[back.reshape(-1)].reshape(*asked.shape[:-1], self.points, 2)

    def _start(self) -> None:
        while len(self.processes) < self.count:
            o = self.options
            trials = [o.friction, o.duration, o.mass, *o.com, *o.inertia, o.row, self.points]
            command = [
                sys.executable,
                "-m",
                "adaptsim_jax.tasks.pushing.engines.served",
                *map(str, trials),
            ]
            environment = os.environ | {"JAX_PLATFORMS": "cpu"}
            self.processes.append(
                subprocess.Popen(
                    command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment
                )
            )

    def _ask(self, process: subprocess.Popen, rows: np.ndarray) -> np.ndarray:
        assert process.stdin is not None and process.stdout is not None
        process.stdin.write(np.array([len(rows)], np.int64).tobytes() + rows.tobytes())
        process.stdin.flush()
        spent = np.frombuffer(_whole(process.stdout, 8), np.float64)[0]
        with _COUNTING:
            self.seconds += float(spent)
        found = np.frombuffer(_whole(process.stdout, len(rows) * self.points * 8), np.float32)
        return found.reshape(len(rows), self.points, 2)


_POOLS: list[_Pool] = []
_COUNTING = threading.Lock()


@functools.cache
def _pool(options: PushOptions, points: int, count: int) -> _Pool:
    """One for all functions of the same scene, so that no more processes run than there are
    cores.
    """
    _POOLS.append(_Pool(options, points, count))
    return _POOLS[-1]


def _whole(stream: IO[bytes], size: int) -> bytes:
    data = stream.read(size)
    if len(data) < size:
        raise RuntimeError("a process that simulates native pushes ended; its last words are above")
    return data


def _serve(words: list[str]) -> None:
    """Answer requests until the pipe closes."""
    import time

    from adaptsim_jax.tasks.pushing.engines import make_backend

    numbers = [float(w) for w in words[1:]]
    duration, mass = numbers[:2]
    options = PushOptions(
        words[0], duration, mass, tuple(numbers[2:5]), tuple(numbers[5:8]), numbers[8]
    )
    points = int(numbers[9])
    simulate = make_backend("native", options, threads=1).simulate
    good = np.round(pushing.rows(options) * np.arange(1, points + 1) / points).astype(int) - 1
    requests, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever prints must not mix with the answers
    while head := requests.read(8):
        count, begin = int(np.frombuffer(head, np.int64)[0]), time.process_time()
        rows = np.frombuffer(_whole(requests, count * 48), np.float64).reshape(count, 6)
        found = simulate(rows[:, :4], rows[:, 4:], np.tile(pushing.START, (count, 1)))
        places = np.where(
            (found.code == pushing.FINE)[:, None, None], found.state[:, good, :2], np.nan
        )
        spent = np.array([time.process_time() - begin])
        answers.write(spent.tobytes() + np.ascontiguousarray(places, np.float32).tobytes())
        answers.flush()


if __name__ == "__main__":
    _serve(sys.argv[1:])
