"""Progress: silent for short work, lines with the time left in a log, a bar on a terminal; of parts
at once, a line at the beginning and at the end of each.
"""

import io
import math

from adaptsim_jax.core import progress as module
from adaptsim_jax.core.progress import clock, parts_progress, progress

TITLES = {"a": "one part", "b": "another"}


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


def test_of_work_without_a_known_end_the_time_so_far_is_told(monkeypatch, capsys):
    time, out = Clock(monkeypatch), io.StringIO()
    with progress("search", out) as report:
        for note in ("one", "two"):
            time.now += 40.0
            report(0.0, math.inf, note)
    assert out.getvalue().splitlines() == [
        "search: 40 s so far, one",
        "search: 1 min 20 s so far, two",
    ]
    out.isatty = lambda: True
    with progress("search", out) as report:
        time.now += 40.0
        report(0.5, 1.0, "begun")
        report(0.0, math.inf, "three")
    assert "three, 40 s so far" in " ".join(capsys.readouterr().err.split())
    with parts_progress(TITLES, out := io.StringIO()) as report:
        report("a", 0.0, math.inf, "three")
    assert out.getvalue().splitlines() == ["one part  three"]


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


def test_each_part_has_a_line_at_its_beginning_and_one_at_its_end():
    stream = io.StringIO()
    with parts_progress(TITLES, stream) as report:
        report("a", 0, 1)
        report("b", 0, 4, "reading")
        report("b", 2, 4, "half way")  # too soon after the last line
        report("a", 1, 1, "reward 0.93")
        report("a", 1, 1)
        report("b", 4, 4)
    assert stream.getvalue().splitlines() == [
        "one part  begun",
        "another   reading",
        "one part  done in 0 s, reward 0.93",
        "another   done in 0 s",
    ]


def test_a_long_part_says_how_far_it_is(monkeypatch):
    monkeypatch.setattr(module, "PART_LINE_EVERY", 0.0)
    stream = io.StringIO()
    with parts_progress(TITLES, stream) as report:
        for done in range(3):
            report("a", done, 4, "fitting" * (done > 0))
    assert stream.getvalue().splitlines()[1:] == [
        "one part  25 %, fitting",
        "one part  50 %, fitting",
    ]


def test_nothing_is_shown_of_a_part_that_never_begins():
    stream = io.StringIO()
    with parts_progress(TITLES, stream) as report:
        report("b", 1, 1)
    assert stream.getvalue() == "another   done in 0 s\n"


def test_bars_of_parts_on_a_terminal(capsys):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    with parts_progress(TITLES, Terminal()) as report:
        report("a", 0, 1)
        report("a", 1, 1, "reward 0.93")
    assert "one part" in capsys.readouterr().err
