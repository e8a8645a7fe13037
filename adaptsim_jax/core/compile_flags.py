"""XLA's flags for programs whose time goes into long loops of small steps, on a CPU.

By default XLA runs a loop's body as one small kernel after another, and asking for each takes
longer than running it. Loops compiled into one kernel each, and kernels by the older emitters, take
a quarter to a third of the time off `adaptsim diagnose`, and a third off its compiling. Programs on
large arrays gain nothing: such
loops run on one core.
"""

from __future__ import annotations

import os
from importlib import metadata

NAME = "XLA_FLAGS"
KNOWN_TO = "0.10."  # jaxlib; an unknown flag ends the process
FLAGS = (
    "--xla_cpu_use_fusion_emitters=false",
    f"--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold={10**12}",
)


def small_steps() -> bool:
    """Set the flags, to be called before the first program is compiled; True where they are set
    now. A user's own `XLA_FLAGS` stay as they are, and a jaxlib that may not know these is left
    alone.
    """
    if NAME in os.environ or not metadata.version("jaxlib").startswith(KNOWN_TO):
        return False
    os.environ[NAME] = " ".join(FLAGS)
    return True
