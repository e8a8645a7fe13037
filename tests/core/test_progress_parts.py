"""Progress of several parts at once: a line at the beginning and at the end of each, whatever the order."""

import io

from adaptsim_jax.core import progress_parts
from adaptsim_jax.core.progress_parts import parts_progress

TITLES = {"a": "one part", "b": "another"}


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
    monkeypatch.setattr(progress_parts, "LINE_EVERY", 0.0)
    stream = io.StringIO()
    with parts_progress(TITLES, stream) as report:
        for done in range(3):
            report("a", done, 4, "fitting" * (done > 0))
    assert stream.getvalue().splitlines()[1:] == ["one part  25 %, fitting", "one part  50 %, fitting"]


def test_nothing_is_shown_of_a_part_that_never_begins():
    stream = io.StringIO()
    with parts_progress(TITLES, stream) as report:
        report("b", 1, 1)
    assert stream.getvalue() == "another   done in 0 s\n"


def test_bars_on_a_terminal(capsys):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    with parts_progress(TITLES, Terminal()) as report:
        report("a", 0, 1)
        report("a", 1, 1, "reward 0.93")
    assert "one part" in capsys.readouterr().err
