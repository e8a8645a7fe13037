"""One writer at a time in a folder: a lock of the operating system, which a process that died does
not hold.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.files import output_errors

LOCK = ".lock"


@contextlib.contextmanager
def one_writer(folder: str | os.PathLike) -> Iterator[None]:
    """Hold `folder`, which must exist, against other processes that write there. BadInput at once
    where one does.

    The lock goes with the process, however it ends; the empty file `.lock` stays. File systems (and
    platforms) without locks are written to without one.
    """
    path = Path(folder) / LOCK
    with output_errors(path):
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        _take(handle, folder)
        yield
    finally:
        os.close(handle)


def _take(handle: int, folder: str | os.PathLike) -> None:
    try:
        import fcntl
    except ImportError:
        return
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        what = "another process is writing there; wait until it ends, or stop it, and run again"
        raise BadInput(f"{folder}: {what}") from None
    except OSError:  # no locks on this file system
        return
