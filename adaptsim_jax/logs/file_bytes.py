"""The bytes of a file of recordings."""

from __future__ import annotations

from pathlib import Path

from adaptsim_jax.core.errors import BadInput


def read_bytes(path: Path) -> bytes:
    """All of a file; BadInput where it cannot be read."""
    try:
        return path.read_bytes()
    except OSError as e:
        raise BadInput(
            f"{path}: cannot be read ({e.strerror}); check the path and its permissions"
        ) from None
