"""Which rows of a log make stretches."""

import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.stretch_rows import TrialSpans, spread, stretch_rows

PARTS = [[(k, 10 * row) for row in range(count)] for k, count in enumerate((2, 8, 4, 1, 6))]


def test_each_trial_has_a_stretch_where_there_is_room():
    assert spread(PARTS, 99) == [row for part in PARTS for row in part]
    few = spread(PARTS, 6)
    assert {k for k, _ in few} == {0, 1, 2, 3, 4}
    assert len(few) == 7  # about six


def test_of_more_trials_than_stretches_some_are_left_out():
    assert [k for k, _ in spread(PARTS, 3)] == [0, 2, 4]


def spans(rows, gap=None, missing=slice(0)):
    """A trial at 100 Hz whose stretches have 20 rows, every other one of them compared."""
    time = 0.01 * np.arange(rows)
    if gap is not None:
        time[gap:] += 1.0
    q = np.zeros((rows, 2))
    q[missing] = np.nan
    return TrialSpans(time, q, np.arange(rows) + 20, 2)


def test_stretches_are_consecutive_and_lie_over_no_gap():
    found = stretch_rows([spans(70), spans(70, gap=30)], 0.2, 99)
    assert found.trial.tolist() == [0, 0, 0, 1, 1]
    assert found.first.tolist() == [0, 20, 40, 0, 30]
    assert (found.last - found.first == 20).all()


def test_a_stretch_with_few_angles_is_left_out():
    found = stretch_rows([spans(70, missing=slice(20, 35))], 0.2, 99)
    assert found.first.tolist() == [0, 40]


def test_a_shorter_stretch_has_its_last_row_again():
    short = TrialSpans(spans(30).time, spans(30).q, np.arange(30) + 10, 2)
    rows, own = stretch_rows([spans(30), short], 0.2, 99).compared()
    assert rows[0].tolist() == list(range(0, 21, 2))
    assert rows[1].tolist() == [0, 2, 4, 6, 8, 10, 10, 10, 10, 10, 10]
    assert own.sum(1).tolist() == [11, 6, 6]


def test_a_log_without_a_whole_stretch_is_refused():
    with pytest.raises(BadInput, match="log: no trial has an unbroken stretch"):
        stretch_rows([spans(15)], 0.2, 99, "log: ")
