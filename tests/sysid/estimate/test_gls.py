"""The Gauss-Newton refit on a toy model, apart from any mechanism."""

from dataclasses import replace

import numpy as np
import pytest

from adaptsim_jax.sysid.estimate.gls import Point, refit
from adaptsim_jax.sysid.estimate.variance import Linearised

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


def line(design: np.ndarray, measured: np.ndarray):
    """A linear model without use for its initial state."""
    rows = len(measured)

    def linearise(point: Point) -> Linearised:
        return Linearised(
            residual=(measured - design @ point.z - point.x0[0, 0] * np.cos(np.arange(rows)))[None],
            jac_state=np.cos(np.arange(rows))[None, :, None],
            jac_theta=design[None],
            atoms=np.zeros((1, rows, 0)),
            impulse=np.zeros((1, rows, 1, 0)),
            dt=np.ones((1, rows)),
            channel=np.zeros(rows, int),
            trial=np.zeros(1, int),
            used=np.ones((1, rows), bool),
        )

    return linearise


def bounded_line(size: float = 1.0):
    """Two nearly alike columns, a third on its own: free, the first would go to -10 and the second to 12."""
    rng = np.random.default_rng(3)
    one, other, third = rng.normal(size=(3, 30))
    design = np.stack([one, one + 0.1 * other, third], 1) * np.array([1.0, 1.0, size])
    return design, design @ np.array([-10.0, 12.0, 0.5 / size])


def test_one_step_goes_to_the_optimum_within_the_bounds():
    """A step that is merely clipped would take the second to 12 beside a first at 0, far above where it began."""
    design, measured = bounded_line()
    low, high = np.array([0.0, -np.inf, -np.inf]), np.full(3, np.inf)
    start = Point(np.array([0.5, 1.5, 0.0]), np.zeros((1, 1)))
    done = refit(line(design, measured), start, np.eye(30)[None], low, high, np.ones(3, bool), iterations=1)
    state = np.cos(np.arange(30.0))[:, None]
    best = np.linalg.lstsq(np.hstack([design[:, 1:], state]), measured, rcond=None)[0]
    np.testing.assert_allclose(done.point.z, [0.0, best[0], best[1]], atol=1e-3)
    assert list(done.at_bound) == [True, False, False]


@pytest.mark.parametrize("size", [0.0, 1e-160])
def test_what_the_data_say_nothing_of_stays_where_it_is(size):
    """The limit of an amplifier that only the trial left out has met; scaled to its own information it would go anywhere."""
    design, _ = bounded_line()
    design[:, 2] *= size
    measured = design[:, :2] @ np.array([1.0, 2.0]) + 0.01 * np.sin(np.arange(30.0))
    start = Point(np.array([0.0, 0.0, 0.4]), np.zeros((1, 1)))
    low, high = np.zeros(3), np.array([9.0, 9.0, 0.95])
    done = refit(line(design, measured), start, np.eye(30)[None], low, high, np.ones(3, bool))
    assert done.point.z[2] == 0.4
    np.testing.assert_allclose(done.point.z[:2], [1.0, 2.0], atol=0.1)


def test_a_second_refit_begins_with_the_damping_that_the_first_one_found():
    calls = []

    def counted(point):
        calls.append(point)
        return linearise(point)

    bound, free, factor = np.array([50.0]), np.array([True]), np.eye(ROWS)[None]
    start = Point(np.array([3.0]), np.zeros((1, 1)))
    first = refit(counted, start, factor, -bound, bound, free, iterations=1)
    fresh = len(calls)
    again = refit(counted, start, factor, -bound, bound, free, iterations=1, damping=first.damping)
    assert len(calls) - fresh < fresh - 1
    assert abs(again.point.z[0]) < 3.0


def test_a_bound_without_slope_is_approached_and_not_reached_in_a_step():
    """The width within which a friction turns: at zero it is sharp, and nothing tells how wide it should be."""

    def bent(point: Point) -> Linearised:
        flat, z, half = line(np.ones((ROWS, 1)), np.full(ROWS, 0.2)), float(point.z[0]), 0.02
        lin = flat(Point(np.array([z**2 / (z**2 + half**2)]), point.x0))
        return replace(lin, jac_theta=2.0 * z * half**2 / (z**2 + half**2) ** 2 * lin.jac_theta)

    start, factor = Point(np.array([0.2]), np.zeros((1, 1))), np.eye(ROWS)[None] * 1e3
    bounds = np.zeros(1), np.ones(1), np.array([True])
    assert refit(bent, start, factor, *bounds).point.z[0] == 0.0
    assert refit(bent, start, factor, *bounds, slow=np.array([True])).point.z[0] == pytest.approx(0.01, rel=1e-3)
