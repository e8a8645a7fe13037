"""Libraries that only some readers need: imported when they are, with one line where they are not
installed.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType

from adaptsim_jax.core.errors import BadInput


def need(path: Path, module: str, extra: str) -> ModuleType:
    """The module, or `BadInput` with the command that installs it."""
    try:
        return importlib.import_module(module)
    except ImportError:
        library = module.partition(".")[0]
        raise BadInput(
            f"{path}: reading it needs {library}; run: pip install 'adaptsim_jax[{extra}]'"
        ) from None
