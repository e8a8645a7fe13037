"""Work in a process of its own: what it tells, what it returns, how it fails, and that it ends with
the block.
"""

import os
import time

import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.parallel import worker_process


def adds(a, b, tell):
    tell("begun", 0.5)
    return a + b, os.getpid()


def refuses(tell):
    raise BadInput("rows.csv, row 3: no number; mend it")


class Odd(Exception):
    def __init__(self, one, two):
        super().__init__(f"{one}-{two}")


def fails_oddly(tell):
    raise Odd(1, 2)


def dies(tell):
    os._exit(7)


def never_ends(tell):
    tell(os.getpid())
    time.sleep(600)


def test_what_it_tells_and_returns_comes_back():
    told = []
    with worker_process(adds, 2, 3, report=lambda *words: told.append(words)) as other:
        total, pid = other.result()
    assert total == 5 and pid != os.getpid() and told == [("begun", 0.5)]


@pytest.mark.parametrize(
    "work, error, says",
    [
        (refuses, BadInput, "row 3: no number"),
        (fails_oddly, RuntimeError, "Odd: 1-2"),
        (dies, RuntimeError, "ended with code 7"),
    ],
)
def test_a_failure_is_raised_here(work, error, says):
    with worker_process(work, report=print) as other, pytest.raises(error, match=says):
        other.result()


def test_it_ends_with_the_block():
    told = []
    with pytest.raises(KeyboardInterrupt), worker_process(never_ends, report=told.append):
        for _ in range(600):
            if told:
                break
            time.sleep(0.05)
        raise KeyboardInterrupt
    with pytest.raises(ProcessLookupError):
        os.kill(told[0], 0)
