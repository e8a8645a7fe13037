"""A sweep shared out by Ray on this machine: one of its workers is killed in the middle, and the
sweep ends whole.
"""

import importlib.util
import json
import os
import signal
import time
from pathlib import Path

import pytest

from tests.sweep.small import SPEC, run, start, write
from tests.sweep.test_devices import rows, same

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        importlib.util.find_spec("ray") is None, reason="Ray is absent: pip install -e .[cluster]"
    ),
]


def workers(driver):
    """Process ids of the driver's Ray workers that run a batch now."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            name = (folder / "cmdline").read_bytes()
            asked = (folder / "environ").read_bytes()
        except OSError:  # it has ended, or is another's
            continue
        if name.startswith(b"ray::_batch") and f"SWEEP_TEST={driver}".encode() in asked:
            found.append(int(folder.name))
    return found


def test_a_worker_that_is_killed_is_replaced(tmp_path, monkeypatch):
    monkeypatch.setenv("SWEEP_TEST", tmp_path.name)
    spec = write(tmp_path, SPEC)
    run([spec, "--out", tmp_path / "plain", "--at-once", "2"])
    process = start(
        [spec, "--out", tmp_path / "out", "--at-once", "2", "--ray", "--save-every", "0"]
    )
    until, parts = time.monotonic() + 300, tmp_path / "out" / "parts"
    # in the middle: one batch is done, and another has begun
    while process.poll() is None and time.monotonic() < until:
        running = workers(tmp_path.name)
        if running and list(parts.glob("*.json")) and list((tmp_path / "out" / "work").iterdir()):
            break
        time.sleep(0.01)
    assert process.poll() is None, process.communicate()[0]
    os.kill(running[0], signal.SIGKILL)
    said = process.communicate(timeout=400)[0]
    assert process.returncode == 0 and "8 members done, 0 failed, 0 left" in said, said
    made = [json.loads(p.read_text())["rows"] for p in sorted(parts.iterdir())]
    assert sorted(row["member"] for some in made for row in some) == list(range(8))  # each once
    same(rows(tmp_path / "out"), rows(tmp_path / "plain"))
