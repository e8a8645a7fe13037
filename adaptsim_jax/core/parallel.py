"""Independent pieces of a diagnosis on several cores.

Threads are enough: compiled programs and NumPy's linear algebra let go of the interpreter while
they run. Each piece is computed as it would be alone, so the answer does not depend on how many
there are at once.
"""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from typing import TypeVar

Given = TypeVar("Given")
Made = TypeVar("Made")

MOST = 4  # at once: each holds the covariances of a recording, and memory traffic is soon the bound


def cores() -> int:
    """Processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def parallel_map(call: Callable[[Given], Made], items: Iterable[Given]) -> list[Made]:
    """`[call(item) for item in items]`, several at once; the first failure in the order of `items`
    is raised.
    """
    items = list(items)
    workers = min(len(items), cores(), MOST)
    if workers < 2:
        return [call(item) for item in items]
    with ThreadPoolExecutor(workers) as pool:
        # NumPy's error state is of a context, and a thread begins with none
        return list(
            pool.map(
                lambda given: given[0].run(call, given[1]), [(copy_context(), i) for i in items]
            )
        )
