"""What a process is run in: forks of processes that used JAX, JAX's switches, and pipes that take
ASCII alone.
"""

from __future__ import annotations

import os
import sys

from adaptsim_jax.core.errors import BadInput

_forked_after_use = [False]
_BRANCHES = "branches that are not taken may hold numbers that do not exist, and what ran away is told by its code"
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
            "this worker was forked from a process that had used JAX, and would hang: make workers "
            "by "
            "multiprocessing.get_context('spawn'), or use JAX in the workers alone"
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
    told = []
    for name, why in PUT_OFF.items():
        if os.environ.get(name, "").strip().lower() not in _OFF:
            os.environ[name] = "0"
            told.append(f"{name} is set and is not heeded: {why}")
    return told


def legible_streams() -> None:
    """Write what a terminal or pipe cannot encode as escapes, in the place of failing."""
    for stream in (sys.stdout, sys.stderr):
        encoding = (getattr(stream, "encoding", None) or "").lower().replace("-", "")
        reconfigure = getattr(stream, "reconfigure", None)
        if encoding not in ("utf8", "") and reconfigure is not None:
            reconfigure(errors="backslashreplace")
