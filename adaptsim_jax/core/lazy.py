"""Imports with care: public names of a package when they are asked for (PEP 562), so that importing
the package stays cheap, and MJX without a word on standard output.
"""

import contextlib
import io
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def lazily(package: str, homes: Mapping[str, str]) -> Callable[[str], Any]:
    """`__getattr__` of `package`, whose public names stand in the modules `homes[name]`, as names
    of `adaptsim_jax`.
    """

    def getattr_(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module '{package}' has no attribute '{name}'")
        return getattr(import_module(f"adaptsim_jax.{homes[name]}"), name)

    return getattr_


def mjx_module() -> Any:
    """`mujoco.mjx`, which prints on its first import that optional parts are absent."""
    with contextlib.redirect_stdout(io.StringIO()):
        return import_module("mujoco.mjx")
