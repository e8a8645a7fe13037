"""Independent pieces of work on several cores: threads, and a process beside this one.

Threads are enough for a diagnosis: compiled programs and NumPy's linear algebra let go of the
interpreter while they run. Each piece is computed as it would be alone, so the answer does not
depend on how many there are at once. A process is for work whose time goes into Python and
compiling, which threads would take turns at.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import queue
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from typing import Any, TypeVar

Given = TypeVar("Given")
Made = TypeVar("Made")

MAX_WORKERS = (
    4  # at once: each holds the covariances of a recording, and memory traffic is soon the bound
)


def cores() -> int:
    """Processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def largest_divisor(limit: int, *totals: int) -> int:
    """The largest number up to `limit` that divides all of `totals`; at least 1."""
    return max(n for n in range(1, max(1, limit) + 1) if all(total % n == 0 for total in totals))


def parallel_map(call: Callable[[Given], Made], items: Iterable[Given]) -> list[Made]:
    """`[call(item) for item in items]`, several at once; the first failure in the order of `items`
    is raised.
    """
    items = list(items)
    workers = min(len(items), cores(), MAX_WORKERS)
    if workers < 2:
        return [call(item) for item in items]
    with ThreadPoolExecutor(workers) as pool:
        # NumPy's error state is of a context, and a thread begins with none
        return list(
            pool.map(
                lambda given: given[0].run(call, given[1]), [(copy_context(), i) for i in items]
            )
        )


_REPORTED, _MADE, _FAILED = "reported", "made", "failed"


class Worker:
    """The work under way; see `worker_process`."""

    def __init__(self, process: Any, pipe: Any, report: Callable[..., None]):
        self._process, self._answer = process, queue.SimpleQueue()
        self._listener = threading.Thread(target=self._listen, args=(pipe, report), daemon=True)
        self._listener.start()

    def result(self) -> Any:
        """What the work returned, once it is done; what it raised is raised here."""
        kind, value = self._answer.get()
        if kind == _FAILED:
            raise value
        return value

    def _listen(self, pipe: Any, report: Callable[..., None]) -> None:
        while True:
            try:
                kind, value = pipe.recv()
            except (EOFError, OSError):
                self._process.join()
                message = (
                    f"a process of this command ended with code {self._process.exitcode}; run it "
                    "again"
                )
                self._answer.put((_FAILED, RuntimeError(message)))
                return
            if kind != _REPORTED:
                self._answer.put((kind, value))
                return
            report(*value)


@contextlib.contextmanager
def worker_process(
    work: Callable[..., Any], *args: Any, report: Callable[..., None]
) -> Iterator[Worker]:
    """`work(*args, tell)` in a new process, which ends with the block at the latest.

    `work` is a function of a module and takes and returns what can be pickled; `report` is called
    here, in a thread of its own, with what the work calls `tell` with. Ctrl-C is for this process
    alone.
    """
    context = multiprocessing.get_context("spawn")  # a fork of a process that used JAX hangs
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=_run, args=(there, work, args), daemon=True)
    process.start()
    there.close()
    try:
        yield Worker(process, here, report)
    finally:
        process.terminate()
        process.join()


def _run(pipe: Any, work: Callable[..., Any], args: tuple[Any, ...]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        answer = (_MADE, work(*args, lambda *words: pipe.send((_REPORTED, words))))
    except BrokenPipeError:  # nobody is there any more
        return
    except Exception as error:
        answer = (_FAILED, _picklable(error))
    pipe.send(answer)


def _picklable(error: Exception) -> Exception:
    """Return the error, or its words in another where it cannot be sent."""
    import pickle

    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error
