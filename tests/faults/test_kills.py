"""Whenever a writer is killed, its folder is whole, goes on, and has lost or doubled nothing."""

import subprocess
import sys

import pytest


@pytest.mark.parametrize("kills", [20, pytest.param(500, marks=pytest.mark.slow)])
def test_a_killed_writer_leaves_its_folder_whole(tmp_path, kills):
    words = [sys.executable, "-m", "tests.faults.killed", str(tmp_path), str(kills), "0"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    steps = [int(x) for x in done.stdout.split()]
    assert min(steps) > 3  # the writers did come to write
