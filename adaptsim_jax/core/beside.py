"""A piece of work in a process of its own, beside this one: what it reports and what it returns
come back through a pipe.

For work whose time goes into Python and compiling, which threads of one process would take turns
at.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import queue
import signal
import threading
from collections.abc import Callable, Iterator
from typing import Any

_TOLD, _MADE, _FAILED = "told", "made", "failed"


class Beside:
    """The work under way; see `beside`."""

    def __init__(self, process: Any, pipe: Any, told: Callable[..., None]):
        self._process, self._answer = process, queue.SimpleQueue()
        self._listener = threading.Thread(target=self._listen, args=(pipe, told), daemon=True)
        self._listener.start()

    def result(self) -> Any:
        """What the work returned, once it is done; what it raised is raised here."""
        kind, value = self._answer.get()
        if kind == _FAILED:
            raise value
        return value

    def _listen(self, pipe: Any, told: Callable[..., None]) -> None:
        while True:
            try:
                kind, value = pipe.recv()
            except (EOFError, OSError):
                self._process.join()
                ended = f"a process of this command ended with code {self._process.exitcode}; run it again"
                self._answer.put((_FAILED, RuntimeError(ended)))
                return
            if kind != _TOLD:
                self._answer.put((kind, value))
                return
            told(*value)


@contextlib.contextmanager
def beside(work: Callable[..., Any], *args: Any, told: Callable[..., None]) -> Iterator[Beside]:
    """`work(*args, tell)` in a new process, which ends with the block at the latest.

    `work` is a function of a module and takes and returns what can be pickled; `told` is called
    here, in a thread of its own, with what the work calls `tell` with. Ctrl-C is for this process
    alone.
    """
    context = multiprocessing.get_context("spawn")  # a fork of a process that used JAX hangs
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=_run, args=(there, work, args), daemon=True)
    process.start()
    there.close()
    try:
        yield Beside(process, here, told)
    finally:
        process.terminate()
        process.join()


def _run(pipe: Any, work: Callable[..., Any], args: tuple[Any, ...]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        answer = (_MADE, work(*args, lambda *words: pipe.send((_TOLD, words))))
    except BrokenPipeError:  # nobody is there any more
        return
    except Exception as error:
        answer = (_FAILED, _plain(error))
    pipe.send(answer)


def _plain(error: Exception) -> Exception:
    """The same, or its words where it cannot be sent."""
    import pickle

    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error
