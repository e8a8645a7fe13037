"""Which rows of a log make stretches."""

from adaptsim_jax.logs.stretch_rows import spread

PARTS = [[(k, 10 * row) for row in range(count)] for k, count in enumerate((2, 8, 4, 1, 6))]


def test_each_trial_has_a_stretch_where_there_is_room():
    assert spread(PARTS, 99) == [row for part in PARTS for row in part]
    few = spread(PARTS, 6)
    assert {k for k, _ in few} == {0, 1, 2, 3, 4}
    assert len(few) == 7  # about six


def test_of_more_trials_than_stretches_some_are_left_out():
    assert [k for k, _ in spread(PARTS, 3)] == [0, 2, 4]
