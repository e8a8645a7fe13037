"""The persistent compile cache of the command line: on by default, set up before JAX is
imported.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

VARIABLE = "ADAPTSIM_CACHE"
MIN_COMPILE_S = "0.2"


def folder() -> Path:
    """Where compiled programs are: $ADAPTSIM_CACHE, $JAX_COMPILATION_CACHE_DIR, or the platform's
    folder.
    """
    for name in (VARIABLE, "JAX_COMPILATION_CACHE_DIR"):
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
    """Without `~`, which stays as it is where there is no home."""
    try:
        return path.expanduser()
    except RuntimeError:
        return path


def enable() -> str | None:
    """Point JAX at the cache folder through the environment; what went wrong in a few words, or
    None.

    Has no effect on a JAX that is imported already: library users set the cache up as they like.
    """
    path = folder()
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
    except OSError as error:
        disable()
        return (
            f"no compile cache: {path} cannot be written ({error.strerror}); set {VARIABLE} to "
            "another folder"
        )
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
