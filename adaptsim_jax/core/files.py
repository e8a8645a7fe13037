"""Files that appear whole or not at all, and one line with the mend where the file system
refuses.
"""

from __future__ import annotations

import contextlib
import errno
import io
import json
import math
import os
import socket
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from adaptsim_jax.core.errors import BadInput


@contextlib.contextmanager
def atomic_file(path: str | os.PathLike) -> Iterator[io.BufferedWriter]:
    """A binary file that appears under `path` whole or not at all: temporary name beside it, fsync,
    rename.

    Raises BadInput where the folder cannot be written or the disk is full, and leaves nothing
    behind then.
    """
    path = Path(path)
    with output_errors(path):
        handle, temporary = tempfile.mkstemp(
            prefix=f".{path.name}.", suffix=".tmp", dir=path.parent
        )
        try:
            with os.fdopen(handle, "wb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            os.chmod(temporary, 0o644)
            os.replace(temporary, path)
        except BaseException:
            with contextlib.suppress(OSError):
                os.unlink(temporary)
            raise
        _sync_folder(path.parent)


def write_bytes(path: str | os.PathLike, data: bytes) -> None:
    """`atomic_file` for data that is at hand."""
    with atomic_file(path) as file:
        file.write(data)


def write_json(path: str | os.PathLike, value: Any) -> None:
    """Strict JSON (NaN is refused, since other readers refuse it), whole or not at all."""
    write_bytes(path, (json.dumps(value, indent=1, allow_nan=False) + "\n").encode())


POINTER = b"version https://git-lfs"


def is_pointer(path: Path) -> bool:
    """Whether a file is a pointer of Git LFS in the place of what it stands for."""
    with path.open("rb") as file:
        return file.read(len(POINTER)) == POINTER


def without_nan(value: Any) -> Any:
    """Plain data (dicts, lists, numbers) with None where a float is not finite, for strict JSON has
    no such number.
    """
    if isinstance(value, dict):
        return {name: without_nan(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


@contextlib.contextmanager
def output_errors(path: str | os.PathLike) -> Iterator[None]:
    """Turns what the file system says about an output into one line with the mend."""
    try:
        yield
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise BadInput(
                f"{path}: no space left on the disk; free some, or name another folder, and run "
                "again"
            ) from error
        raise BadInput(
            f"{path}: cannot be written ({error.strerror or error}); name a folder that you may "
            "write to"
        ) from error


def output_folder(path: str | os.PathLike) -> Path:
    """Make `path` if need be and make sure, before any work is done, that files can be written
    there.
    """
    path = Path(path)
    with output_errors(path):
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path) as probe:
            probe.write(b"\0")
    return path


def _sync_folder(folder: Path) -> None:
    # A rename is only as lasting as its directory entry; some file systems refuse to sync a
    # directory.
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


# ---------------------------------------------------------------- one writer at a time

LOCK = ".lock"
BUSY = "another process is writing there; wait until it ends, or stop it, and run again"


@contextlib.contextmanager
def one_writer(folder: str | os.PathLike, lock: str = LOCK, busy: str = BUSY) -> Iterator[None]:
    """Hold `folder`, which must exist, against other processes that write there. BadInput at once
    where one does.

    The lock goes with the process, however it ends; the file stays, and says who held it last. File
    systems (and platforms) without locks are written to without one.

    Args:
        lock: Name of the file. busy: What is wrong where another process holds it; `{holder}` in it
            is that process.
    """
    path = Path(folder) / lock
    with output_errors(path):
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        if not _takes_lock(handle):
            holder = os.read(handle, 200).decode().strip() or "another process"
            raise BadInput(f"{folder}: {busy.format(holder=holder)}")
        yield
    finally:
        os.close(handle)


def _takes_lock(handle: int) -> bool:
    """Whether the lock is this process's now, whose name it then holds."""
    try:
        import fcntl
    except ImportError:
        return True
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # no locks on this file system
        return True
    since = time.strftime("%Y-%m-%d %H:%M:%S")
    os.ftruncate(handle, 0)
    os.write(handle, f"process {os.getpid()} on {socket.gethostname()} since {since}\n".encode())
    return True
