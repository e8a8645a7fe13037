"""What a process is run in and with: forks, JAX's switches, streams that take ASCII alone, XLA's
flags, memory.

Three settings are for programs that trace and compile a lot. XLA's flags: by default a loop's body
runs as one small kernel after another, and asking for each takes longer than running it. Loops
compiled into one kernel each take a quarter to a third of the time off `adaptsim diagnose`. Memory:
XLA on a CPU asks the C library for every array and gives it back after use. One arena that keeps
what it has is faster, and smaller at its peak. Garbage: rare searches.
"""

from __future__ import annotations

import contextlib
import gc
import io
import os
import platform
import signal
import stat
import sys
import tempfile
import threading
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

from adaptsim_jax.core.errors import BadInput

CACHE_VARIABLE = "ADAPTSIM_CACHE"

# ---------------------------------------------------------------- the compile cache
#
# The persistent compile cache of the command line: on by default, set up before JAX is imported.

MIN_COMPILE_S = "0.2"


def cache_folder() -> Path:
    """Return the folder of compiled programs: $ADAPTSIM_CACHE, $JAX_COMPILATION_CACHE_DIR, or the
    platform's folder.
    """
    for name in (CACHE_VARIABLE, "JAX_COMPILATION_CACHE_DIR"):
        if os.environ.get(name):
            return _expanded(Path(os.environ[name]))
    return _platform_folder() / "adaptsim_jax" / "xla"


def _platform_folder() -> Path:
    if sys.platform == "darwin":
        return _home() / "Library" / "Caches"
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", _home() / "AppData" / "Local"))
    return Path(os.environ.get("XDG_CACHE_HOME") or _home() / ".cache")


def _home() -> Path:
    """The home folder; where there is none, as in a container whose user has no name, one of the
    user's own for temporary files.
    """
    try:
        return Path.home()
    except RuntimeError:
        return (
            Path(tempfile.gettempdir()) / f"home-{os.getuid() if hasattr(os, 'getuid') else 'user'}"
        )


def _expanded(path: Path) -> Path:
    """Expand `~`, which stays as it is where there is no home."""
    try:
        return path.expanduser()
    except RuntimeError:
        return path


def enable_cache() -> str | None:
    """Point JAX at the cache folder through the environment; what went wrong in a few words, or
    None.

    Has no effect on a JAX that is imported already: library users set the cache up as they like.
    """
    path = cache_folder()
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
    except OSError as error:
        disable_cache()
        return (
            f"no compile cache: {path} cannot be written ({error.strerror}); set "
            f"{CACHE_VARIABLE} to another folder"
        )
    os.environ["JAX_COMPILATION_CACHE_DIR"] = str(path)
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", MIN_COMPILE_S)
    return None


def disable_cache() -> None:
    """Compile anew each time."""
    os.environ.pop("JAX_COMPILATION_CACHE_DIR", None)
    os.environ["JAX_ENABLE_COMPILATION_CACHE"] = "false"


def cache_size() -> tuple[int, int]:
    """(number of files, bytes) in the cache folder."""
    files = [path for path in cache_folder().rglob("*") if path.is_file()]
    return len(files), sum(path.stat().st_size for path in files)


_forked_after_use = [False]
_BRANCHES = (
    "branches that are not taken may hold numbers that do not exist, and what ran away is told by "
    "its code"
)
PUT_OFF = {
    "JAX_ENABLE_X64": "adaptsim computes in single precision",
    "JAX_DEBUG_NANS": _BRANCHES,
    "JAX_DEBUG_INFS": _BRANCHES,
}
"""Switches of JAX that are not heeded, with why."""
_OFF = ("", "0", "false", "off", "no")


def _note_fork() -> None:
    bridge = sys.modules.get("jax._src.xla_bridge")
    initialised = getattr(bridge, "backends_are_initialized", lambda: False)
    _forked_after_use[0] = _forked_after_use[0] or bool(initialised())


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_note_fork)


def check_process() -> None:
    """BadInput in a forked worker of a process that had used JAX, whose threads are not there and
    would be waited for.
    """
    if _forked_after_use[0]:
        raise BadInput(
            "this worker was forked from a process that had used JAX, and would hang: make "
            "workers by multiprocessing.get_context('spawn'), or use JAX in the workers alone"
        )


def computing() -> list[str]:
    """Put off what the environment says of how JAX computes and we cannot heed; a line on each.

    BadInput where a program that called us turned double precision on: its arrays would not fit
    ours.
    """
    if "jax" in sys.modules:
        import jax

        if jax.config.read("jax_enable_x64"):
            raise BadInput(
                "JAX computes in double precision here (jax_enable_x64), adaptsim in single: turn "
                "it off"
            )
        return []
    lines = []
    for name, why in PUT_OFF.items():
        if os.environ.get(name, "").strip().lower() not in _OFF:
            os.environ[name] = "0"
            lines.append(f"{name} is set and is not heeded: {why}")
    return lines


class Pipe(io.FileIO):
    """A pipe whose reader may go away (`adaptsim effects | head`): what is written then is lost,
    and the work goes on.
    """

    def write(self, data: Any) -> int:
        """The number of bytes written, or lost."""
        try:
            return super().write(data) or 0
        except BrokenPipeError:
            return len(data)


def patient_output() -> None:
    """Go on where the reader of standard output went away."""
    out: Any = sys.stdout
    ours = out is sys.__stdout__ and isinstance(out, io.TextIOWrapper)
    if not ours or not stat.S_ISFIFO(os.fstat(out.fileno()).st_mode):
        return
    out.flush()
    pipe: Any = Pipe(os.dup(out.fileno()), "wb")
    if isinstance(out.buffer, io.BufferedWriter):  # not under PYTHONUNBUFFERED
        pipe = io.BufferedWriter(pipe)
    sys.stdout = io.TextIOWrapper(
        pipe, out.encoding, out.errors, None, out.line_buffering, out.write_through
    )


@contextlib.contextmanager
def stopped_by_sigterm() -> Iterator[None]:
    """Within it SIGTERM, as a scheduler sends it, stops the work as Ctrl-C does."""
    ours = threading.current_thread() is threading.main_thread()
    if not ours or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def legible_streams() -> None:
    """Write what a terminal or pipe cannot encode as escapes, in the place of failing."""
    for stream in (sys.stdout, sys.stderr):
        encoding = (getattr(stream, "encoding", None) or "").lower().replace("-", "")
        reconfigure = getattr(stream, "reconfigure", None)
        if encoding not in ("utf8", "") and reconfigure is not None:
            reconfigure(errors="backslashreplace")


# ---------------------------------------------------------------- XLA's flags

NAME = "XLA_FLAGS"
KNOWN_TO = "0.10."  # jaxlib; an unknown flag ends the process
FLAGS = (
    "--xla_cpu_use_fusion_emitters=false",
    f"--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold={10**12}",
)


def small_steps() -> bool:
    """Set the flags, to be called before the first program is compiled; True where they are set
    now. A user's own `XLA_FLAGS` stay as they are. A jaxlib that may not know these is left alone,
    and the user is informed.
    """
    if NAME in os.environ:
        return False
    if not (version := metadata.version("jaxlib")).startswith(KNOWN_TO):
        print(
            f"adaptsim: jaxlib {version}: XLA's flags for loops of small steps are known of "
            f"{KNOWN_TO}* alone and are left out; this may take a third longer",
            file=sys.stderr,
        )
        return False
    os.environ[NAME] = " ".join(FLAGS)
    return True


# ---------------------------------------------------------------- memory

_M_TRIM_THRESHOLD, _M_TOP_PAD, _M_MMAP_MAX, _M_ARENA_MAX = -1, -2, -4, -8
_SETTINGS = {
    "MALLOC_ARENA_MAX": (_M_ARENA_MAX, 1),
    "MALLOC_MMAP_MAX_": (_M_MMAP_MAX, 0),
    "MALLOC_TRIM_THRESHOLD_": (_M_TRIM_THRESHOLD, 2**31 - 1),
    "MALLOC_TOP_PAD_": (_M_TOP_PAD, 2**26),
}

# objects made, less those gone, before Python looks for garbage among them (its own default: 700)
YOUNG = 100_000


def collect_rarely() -> None:
    """Look for unreachable objects a hundred times less often: JAX's tracing makes millions that
    all stay, and looking through them is a tenth of the time of a short diagnosis.
    """
    gc.set_threshold(YOUNG, 10, 10)


def keep_freed() -> bool:
    """Set glibc's allocator so; True where it took all settings, False elsewhere and where the user
    has set it up.

    To be called before other threads run, as the command line does; any variable of glibc's own
    that is set (`MALLOC_ARENA_MAX`, `MALLOC_MMAP_MAX_`, `MALLOC_TRIM_THRESHOLD_`,
    `MALLOC_TOP_PAD_`, `GLIBC_TUNABLES`) leaves it as it is.
    """
    if not sys.platform.startswith("linux") or platform.libc_ver()[0] != "glibc":
        return False
    if any(name in os.environ for name in (*_SETTINGS, "GLIBC_TUNABLES")):
        return False
    import ctypes

    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return False
    return all(mallopt(option, value) == 1 for option, value in _SETTINGS.values())
