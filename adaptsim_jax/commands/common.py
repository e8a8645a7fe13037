"""What several commands share: tasks by name, seeds, and words about where results are."""

from __future__ import annotations

import argparse
import importlib.util

from adaptsim_jax.commands import TASKS
from adaptsim_jax.config import pick
from adaptsim_jax.errors import BadInput

MAX_SEED = 2**32 - 1


def available_tasks() -> list[str]:
    """The tasks whose room exists in this version; looks at files, imports nothing."""
    return [task for task in TASKS if importlib.util.find_spec(f"adaptsim_jax.tasks.{task}") is not None]


def check_task(task: str) -> str:
    """`task` if it is known and there; BadInput with the nearest name otherwise."""
    pick("task", task, TASKS)
    if task not in available_tasks():
        raise BadInput(f"task '{task}' is not in this version yet; there is: {', '.join(available_tasks())}")
    return task


def seed(text: str) -> int:
    """A seed of JAX: an integer in [0, 2^32)."""
    try:
        value = int(text)
    except ValueError:
        value = -1
    if not 0 <= value <= MAX_SEED:
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number from 0 to {MAX_SEED}; try --seed 0")
    return value


def positive(text: str) -> int:
    """A count of at least one."""
    try:
        value = int(text)
    except ValueError:
        value = 0
    if value < 1:
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number of at least 1; try 1")
    return value
