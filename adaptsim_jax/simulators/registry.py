"""What simulates recordings in a diagnosis: ours, and functions of other packages that make one."""

from collections.abc import Callable
from pathlib import Path

from adaptsim_jax.core.config import suggest
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.registry import Registry, function_named
from adaptsim_jax.diagnosis.simulator import Simulator

OF_MECHANISMS = ("tree", "mujoco")
"""Simulators of ours, for a mechanism whose model file the recording names."""
SIMULATORS: Registry[Callable[[Path], Simulator]] = Registry("simulators", own={})
"""Functions of other packages (entry points `adaptsim.simulators`): `(folder of recordings) ->
Simulator`.
"""


def simulator_named(name: str) -> Callable[[Path], Simulator]:
    """What makes a simulator of a folder: an entry point's name, `module:function` or
    `file.py:function`.

    Raises BadInput where there is none of that name.
    """
    if name in SIMULATORS:
        return SIMULATORS[name]
    if ":" in name:
        return function_named(name, "--simulator")
    known = (*OF_MECHANISMS, *SIMULATORS, "module:function", "file.py:function")
    raise BadInput(f"--simulator: '{name}' is unknown; {suggest(name, known)}")
