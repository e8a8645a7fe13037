"""Memory as programs that trace and compile a lot want it: freed arrays kept for the next one,
where the C library is glibc, and rare searches for garbage.

XLA on a CPU asks the C library for every array and gives it back after use. Large ones go back to
the system at once, and the next one is paid for page by page again: a fifth of the processor time
of `adaptsim diagnose`.
One arena that keeps what it has is faster, and smaller at its peak.
"""

from __future__ import annotations

import ctypes
import gc
import os
import platform
import sys

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
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return False
    return all(mallopt(option, value) == 1 for option, value in _SETTINGS.values())
