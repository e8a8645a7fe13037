"""Stretches whose derivatives no square can hold say nothing of where to go."""

import numpy as np

from adaptsim_jax.attribution.estimate import MAX_DERIVATIVE, _without_lost


def test_derivatives_that_are_finite_but_too_large_to_square_are_lost():
    start = np.ones((3, 4, 2))
    start[1, 2, 0] = 1e200  # finite, and its square is not
    residual, lost = np.ones((3, 4)), np.full((3, 4, 1), 0.5 * MAX_DERIVATIVE)
    _without_lost(residual, start, lost)
    assert np.all(np.isfinite(np.square(start))) and not start[1].any() and not residual[1].any()
    assert start[[0, 2]].all() and residual[[0, 2]].all()
