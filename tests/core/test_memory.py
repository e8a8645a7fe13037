"""The allocator of the command line: freed memory is used again, and a user's own settings
stand.
"""

import os
import platform
import subprocess
import sys

import pytest

from adaptsim_jax.core import process

GLIBC = sys.platform.startswith("linux") and platform.libc_ver()[0] == "glibc"
LOOP = """
import resource
from adaptsim_jax.core import process
print(process.keep_freed() if {keep} else False)
bytearray(60_000_000)
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(10):
    bytearray(60_000_000)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def faults(keep: bool, **variables: str) -> tuple[str, int]:
    environment = {
        k: v for k, v in os.environ.items() if not k.startswith(("MALLOC_", "GLIBC_"))
    } | variables
    command = [sys.executable, "-c", LOOP.format(keep=keep)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    said, count = done.stdout.split()
    return said, int(count)


@pytest.mark.skipif(not GLIBC, reason="the settings are glibc's")
def test_freed_memory_is_kept_for_the_next_array():
    plain, kept = faults(False), faults(True)
    assert kept[0] == "True" and kept[1] < 0.1 * plain[1]


@pytest.mark.skipif(not GLIBC, reason="the settings are glibc's")
def test_the_settings_of_a_user_stand():
    assert faults(True, MALLOC_ARENA_MAX="4")[0] == "False"


def test_other_systems_are_left_alone(monkeypatch):
    monkeypatch.setattr(process.platform, "libc_ver", lambda: ("", ""))
    assert process.keep_freed() is False


def test_garbage_is_looked_for_rarely():
    code = (
        "import gc; from adaptsim_jax.core import process; process.collect_rarely(); "
        "print(gc.get_threshold()[0])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert int(done.stdout) == process.YOUNG
