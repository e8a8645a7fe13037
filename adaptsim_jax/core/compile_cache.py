"""The persistent compile cache of the command line: on by default, set up before JAX is imported."""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

VARIABLE = "ADAPTSIM_CACHE"
MIN_COMPILE_S = "0.2"


def folder() -> Path:
    """Where compiled programs are: $ADAPTSIM_CACHE, $JAX_COMPILATION_CACHE_DIR, or the platform's folder."""
    for name in (VARIABLE, "JAX_COMPILATION_CACHE_DIR"):
        if os.environ.get(name):
            return Path(os.environ[name]).expanduser()
    return _platform_folder() / "adaptsim_jax" / "xla"


def _platform_folder() -> Path:
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def enable() -> str | None:
    """Point JAX at the cache folder through the environment; what went wrong in a few words, or None.

    Has no effect on a JAX that is imported already: library users set the cache up as they like.
    """
    path = folder()
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
    except OSError as error:
        disable()
        return f"no compile cache: {path} cannot be written ({error.strerror}); set {VARIABLE} to another folder"
    os.environ["JAX_COMPILATION_CACHE_DIR"] = str(path)
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", MIN_COMPILE_S)
    return None


def disable() -> None:
    """Compile anew each time."""
    os.environ.pop("JAX_COMPILATION_CACHE_DIR", None)
    os.environ["JAX_ENABLE_COMPILATION_CACHE"] = "false"


def size() -> tuple[int, int]:
    """(number of files, bytes) in the cache folder."""
    files = [path for path in folder().rglob("*") if path.is_file()]
    return len(files), sum(path.stat().st_size for path in files)
