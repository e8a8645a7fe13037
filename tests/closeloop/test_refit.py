"""The Gauss-Newton refit on a toy model, apart from any mechanism."""

import numpy as np
import pytest

from adaptsim_jax.closeloop.disturbance import Linearised
from adaptsim_jax.closeloop.refit import Point, refit

ROWS = 4


def linearise(point: Point) -> Linearised:
    """A measured 0 against 10 atan(z) in every row: from far, a full Gauss-Newton step raises the cost."""
    z = float(point.z[0])
    rows = np.ones((1, ROWS))
    empty = np.zeros((1, ROWS, 0))
    slope = 10.0 / (1.0 + z**2) * rows[..., None]
    state = np.linspace(-1.0, 1.0, ROWS)[None, :, None]  # as good as another offset, and of no use here
    return Linearised(
        residual=-10.0 * np.arctan(z) * rows - state[..., 0] * point.x0[:, :1],
        jac_state=state,
        jac_theta=slope,
        atoms=empty,
        impulse=np.zeros((1, ROWS, 1, 0)),
        dt=np.ones((1, ROWS)),
        channel=np.zeros(ROWS, int),
        trial=np.zeros(1, int),
        used=np.ones((1, ROWS), bool),
    )


@pytest.mark.parametrize("iterations", [1, 2])
def test_steps_that_raise_the_cost_are_shortened_and_do_not_count(iterations):
    start = Point(np.array([3.0]), np.zeros((1, 1)))
    bound, free = np.array([50.0]), np.array([True])
    done = refit(linearise, start, np.eye(ROWS)[None], -bound, bound, free, iterations=iterations)
    assert done.iterations == iterations
    assert abs(done.point.z[0]) < 3.0
    settled = refit(linearise, start, np.eye(ROWS)[None], -bound, bound, free, iterations=20)
    assert settled.point.z[0] == pytest.approx(0.0, abs=1e-3)
    assert settled.cost.sum() <= done.cost.sum()
