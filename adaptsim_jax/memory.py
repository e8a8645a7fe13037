"""Keep freed memory for the next array, where the C library is glibc.

XLA on a CPU asks the C library for every array and gives it back after use. Large ones go back to the system at once,
and the next one is paid for page by page again: a fifth of the processor time of `adaptsim diagnose`
(docs/results/closeloop.md). One arena that keeps what it has is faster, and smaller at its peak.
"""

from __future__ import annotations

import ctypes
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


def keep_freed() -> bool:
    """Set glibc's allocator so; True where it took all settings, False elsewhere and where the user has set it up.

    To be called before other threads run, as the command line does; any variable of glibc's own that is set
    (`MALLOC_ARENA_MAX`, `MALLOC_MMAP_MAX_`, `MALLOC_TRIM_THRESHOLD_`, `MALLOC_TOP_PAD_`, `GLIBC_TUNABLES`) leaves it as it is.
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
