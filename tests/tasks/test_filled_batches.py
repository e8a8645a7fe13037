"""Batches of one size: every sample is in one, and the last is filled up with the last sample."""

import numpy as np
import pytest

from adaptsim_jax.tasks.engine import filled_batches


@pytest.mark.parametrize(("count", "size"), [(1, 4), (4, 4), (5, 4), (9, 3)])
def test_batches_have_one_size_and_hold_every_sample_once(count, size):
    batches = filled_batches(count, size)
    assert all(len(rows) == size and rows.max() < count for _, rows in batches)
    kept = [rows[: place.stop - place.start] for place, rows in batches]
    np.testing.assert_array_equal(np.concatenate(kept), np.arange(count))
