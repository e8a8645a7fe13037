"""Steps within bounds, and both loops, on problems whose answers are known."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear, nnls

from adaptsim_jax.diagnosis.steps import (
    NotFinite,
    Point,
    StretchLanes,
    best_of,
    bounded_step,
    fit_starts,
    fit_values,
)
from adaptsim_jax.diagnosis.straight import doing_nothing

FREE = np.full(2, np.inf)
HESS = np.array([[2.0, 0.8], [0.8, 1.0]])


def test_a_free_step_solves_the_normal_equations():
    slope = np.array([1.0, -1.0])
    step = bounded_step(HESS, slope, -FREE, FREE)
    np.testing.assert_allclose(step, np.linalg.solve(HESS, slope), rtol=1e-8)


def test_what_meets_a_bound_is_held_there_and_the_others_are_solved_for_again():
    step = bounded_step(HESS, np.array([3.0, 1.0]), -FREE, np.array([0.5, 9.0]))
    np.testing.assert_allclose(step, [0.5, 1.0 - 0.8 * 0.5], rtol=1e-8)


def test_a_number_without_curvature_does_not_move():
    assert bounded_step(np.diag([2.0, 0.0]), np.array([1.0, 5.0]), -FREE, FREE)[1] == 0.0


def like_an_arm(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Columns [R, 11] of unlike sizes, and what is left [R]; half of the numbers are zero."""
    size = 10.0 ** rng.uniform(-2.0, 2.0, 11)
    alike = rng.normal(size=(60, 3)) @ rng.normal(size=(3, 11))
    columns = (rng.normal(size=(60, 11)) + rng.uniform(0.0, 2.0) * alike) * size
    truth = np.maximum(rng.normal(size=11), 0.0) / size
    return columns, columns @ truth + rng.uniform(0.1, 3.0) * rng.normal(size=60)


def test_a_step_is_the_least_within_its_bounds():
    for seed in range(200):
        columns, left = like_an_arm(np.random.default_rng(seed))
        hess, slope, none = columns.T @ columns, columns.T @ left, np.zeros(11)
        step = bounded_step(hess, slope, none, np.full(11, np.inf))
        least = nnls(columns, left)[1] ** 2
        assert np.square(left - columns @ step).sum() <= least * (1.0 + 1e-9)


def test_a_step_is_the_least_between_two_ends_with_damping():
    for seed in range(50):
        rng = np.random.default_rng(seed)
        columns, left = like_an_arm(rng)
        size = np.linalg.norm(columns, axis=0)
        low, high = rng.uniform(-2.0, 0.0, 11) / size, rng.uniform(0.0, 2.0, 11) / size
        step = bounded_step(columns.T @ columns, columns.T @ left, low, high, 0.1)
        wide = np.concatenate([columns, np.sqrt(0.1) * np.diag(size)])
        known = np.concatenate([left, np.zeros(11)])
        least = 2.0 * lsq_linear(wide, known, (low, high), tol=1e-14).cost
        assert np.square(known - wide @ step).sum() <= least * (1.0 + 1e-9)


def test_a_simulation_that_ran_away_gives_no_step():
    with pytest.raises(NotFinite):
        bounded_step(np.array([[np.inf, 0.0], [0.0, 1.0]]), np.ones(2), -FREE, FREE)

    def around(point):
        return lambda damping: bounded_step(np.full((2, 2), np.nan), FREE, -FREE, FREE)

    found = fit_values(Point(1.0, None), around, 3)
    assert found.code == "stuck"
    assert found.point.loss == 1.0


def rosenbrock(x):
    left = np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])
    return Point(0.5 * float(left @ left), x)


def test_values_reach_the_end_of_a_curved_valley():
    def around(point):
        x = point.state
        left = np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])
        columns = np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]])
        hess, slope = columns.T @ columns, -columns.T @ left
        return lambda damping: rosenbrock(x + bounded_step(hess, slope, -FREE, FREE, damping))

    found = fit_values(rosenbrock(np.array([-1.2, 1.0])), around, rounds=60)
    np.testing.assert_allclose(found.point.state, [1.0, 1.0], atol=1e-6)
    assert fit_values(found.point, around, rounds=0).code == "stopped"


def test_a_fit_that_nothing_helps_is_stuck():
    def around(point):
        return lambda damping: Point(max(2.0, point.loss - 1.0), None)

    assert fit_values(Point(2.0, None), around, 5).code == "stuck"


@pytest.mark.parametrize("every", [False, True])
def test_starts_of_stretches_are_fitted_each_by_itself(every):
    rng = np.random.default_rng(0)
    columns, truth = rng.normal(size=(5, 9, 2)), rng.normal(size=(5, 2))
    seen = np.einsum("wrs,ws->wr", columns, truth)

    def evaluate(starts, lanes):
        left = seen[lanes] - np.einsum("wrs,ws->wr", columns[lanes], starts)
        return left, np.square(left).sum(1)

    def propose(starts, left, lanes):
        step = np.einsum("wsr,wr->ws", np.linalg.pinv(columns[lanes]), left)
        return starts + np.array([3.0, 1.0])[:, None, None] * step

    begun = best_of((np.zeros((5, 2)), truth * [[1.0], [0.0], [0.0], [0.0], [0.0]]), evaluate)
    assert begun.loss[0] == 0.0 < begun.loss[1]
    found = fit_starts(StretchLanes(*begun), propose, evaluate, 3, every=every, lanes=np.arange(4))
    np.testing.assert_allclose(found.starts[:4], truth[:4], atol=1e-8)
    np.testing.assert_allclose(found.starts[4], 0.0)
    assert begun.loss[1] > 0.0  # what was given stays as it was


def test_what_needs_no_model_is_a_line_through_what_was_seen_and_its_mean():
    rng = np.random.default_rng(0)
    time, z = 5.0 + np.sort(rng.uniform(0.0, 1.0, (3, 20))), rng.normal(size=(3, 20, 2))
    seen = rng.uniform(size=z.shape) < 0.7
    line, still = doing_nothing(time, z, seen)
    for w, c in np.ndindex(3, 2):
        t, y = time[w, seen[w, :, c]], z[w, seen[w, :, c], c]
        left = y - np.polyval(np.polyfit(t, y, 1), t)
        assert line[w, c] == pytest.approx(np.sqrt(np.mean(left**2)))
        assert still[w, c] == pytest.approx(np.std(y))
