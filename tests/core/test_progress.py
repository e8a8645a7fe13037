"""Progress: silent for short work, lines with the time left in a log, a bar on a terminal."""

import io

from adaptsim_jax.core import progress as module
from adaptsim_jax.core.progress import clock, progress


class Clock:
    def __init__(self, monkeypatch):
        self.now = 100.0
        monkeypatch.setattr(module.time, "monotonic", lambda: self.now)


def told(monkeypatch, seconds_each, steps):
    time, out = Clock(monkeypatch), io.StringIO()
    with progress("train", out) as report:
        for step in range(1, steps + 1):
            time.now += seconds_each
            report(step, steps, f"reward {step}")
    return out.getvalue().splitlines()


def test_short_work_says_nothing(monkeypatch):
    assert told(monkeypatch, 0.1, 10) == []


def test_long_work_says_the_time_left(monkeypatch):
    lines = told(monkeypatch, 1.0, 100)
    assert lines[0] == "train: 2 %, 1 min 38 s left, reward 2"
    assert lines[-1].startswith("train: 92 %, 8 s left")
    assert len(lines) == 10


def test_compile_time_in_the_first_chunk_does_not_spoil_the_rate(monkeypatch):
    time, out = Clock(monkeypatch), io.StringIO()
    with progress("train", out) as report:
        time.now += 30.0
        report(1, 11)
        for step in range(2, 12):
            time.now += 10.0
            report(step, 11)
    assert out.getvalue().splitlines()[1] == "train: 18 %, 1 min 30 s left"


def test_a_bar_on_a_terminal(monkeypatch, capsys):
    time, out = Clock(monkeypatch), io.StringIO()
    out.isatty = lambda: True
    with progress("train", out) as report:
        report(0, 10)
        time.now += 3.0
        report(5, 10, "reward 0.5")
    assert "train" in capsys.readouterr().err


def test_clock():
    assert [clock(s) for s in (-1, 3.4, 65, 3700)] == ["0 s", "3 s", "1 min 05 s", "1 h 01 min"]
