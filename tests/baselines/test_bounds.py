"""UDR, best in Omega, gradient descent and the step grid's ceiling against answers that are
known.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.baselines import exact_methods
from adaptsim_jax.baselines.bounds import (
    best_in_omega,
    costs,
    discrepancy,
    pendulum_problem,
    reward_map,
    udr,
)
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.pendulum.task import SETTINGS, PendulumConfig, pendulum_space
from experiments.reachable import ceiling, reachable_values
from tests.baselines.probe import SPACE, probe_problem

TARGETS = np.array([[1.25, 26.0], [0.5, 40.0]])


def test_udr_is_the_centre_of_a_quadratic():
    out = udr(probe_problem(), restarts=2)
    np.testing.assert_allclose(
        out.policy, [1.5, 20.0], rtol=1e-3
    )  # Sobol's mean is the centre to 2^-9 of the range
    np.testing.assert_allclose(out.restarts, out.restarts[0], rtol=1e-6)


def test_best_in_omega_is_the_target_or_its_clip():
    best = best_in_omega(probe_problem(), TARGETS, points=4)
    np.testing.assert_allclose(best.mean, [[0.25, 0.8], [0.0, 1.0]], atol=1e-6)
    np.testing.assert_allclose(best.cost, [1.0, 1.0 + 0.25 + 1.0], rtol=1e-10)


def test_costs_and_discrepancy_are_per_target():
    means = np.full((2, 3, 2), 0.5)
    out = costs(probe_problem(), means, TARGETS)
    np.testing.assert_allclose(
        out, np.repeat([[1 + 0.0625 + 0.36], [1 + 1.0 + 4.0]], 3, axis=1), rtol=1e-12
    )
    apart = discrepancy(probe_problem(), means, TARGETS)
    np.testing.assert_allclose(apart[:, 0], 2 * np.abs(TARGETS - [1.5, 20.0]).sum(1), rtol=1e-12)


@pytest.mark.parametrize(
    ("target", "goal"), list(zip(TARGETS, [[0.25, 0.8], [0.0, 1.0]], strict=True))
)
def test_descent_reaches_the_best_and_stays_in_the_box(target, goal):
    with jax.enable_x64(True):
        run = jax.jit(
            lambda u: exact_methods.descend(probe_problem().slope, u, jnp.asarray(target), 25)
        )
        info = run(jnp.array([0.9, 0.1]))
    u = np.asarray(info.u)
    assert np.all((u >= 0) & (u <= 1))
    np.testing.assert_allclose(u[-1], goal, atol=1e-4)


def test_reachable_values_include_the_shift_at_an_end():
    np.testing.assert_allclose(
        reachable_values(0.25, 0.1, 3), [0, 0.05, 0.15, 0.25, 0.35, 0.45, 0.55]
    )
    values = reachable_values(0.25, 0.1, 4)  # three steps down to 0, one up to the shifted 0.1
    assert 0.1 in values and 0.65 in values


def test_ceiling_is_that_of_the_whole_grid():
    problem, target = probe_problem(), TARGETS[0]
    means, found = ceiling(
        problem, np.array([[0.93, 0.07]]), target, np.array([0.25, 0.8]), delta=0.2, steps=4
    )
    grid = np.array(
        [[a, b] for a in reachable_values(0.93, 0.2, 4) for b in reachable_values(0.07, 0.2, 4)]
    )
    exact = costs(problem, grid[None], target[None])[0]
    assert found[0] == pytest.approx(exact.min(), rel=1e-12)
    np.testing.assert_allclose(means[0], grid[exact.argmin()])


def test_reward_map_peaks_at_the_target():
    found = reward_map(
        probe_problem(), TARGETS[0], (2.0, 1.0), names=("a", "b"), points=21, others=1
    )
    y, x = np.unravel_index(found.reward.argmax(), found.reward.shape)
    assert (found.x[x], found.y[y]) == pytest.approx((1.25, 26.0))
    assert found.reward.max() == pytest.approx(1.0)


def test_sizes_are_checked():
    with pytest.raises(BadInput, match="restarts"):
        udr(probe_problem(), restarts=0)
    with pytest.raises(BadInput, match="points a side"):
        best_in_omega(probe_problem(), TARGETS, points=1)


@pytest.fixture(scope="module")
def pendulum_bounds():
    problem = pendulum_problem(pendulum_space())
    targets = np.array([problem.space.values(SETTINGS[s], s) for s in ("wd", "ood-1")])
    return problem, targets, best_in_omega(problem, targets, points=5, starts=1)


@pytest.mark.slow
def test_pendulums_best_beats_the_targets_own_lqr_within_omega(pendulum_bounds):
    """LQR is optimal for an endless horizon; over 2.5 s a neighbour may be a little better, never
    much.
    """
    problem, targets, best = pendulum_bounds
    with jax.enable_x64(True):
        own = float(problem.cost(targets[0], problem.policy(jnp.asarray(targets[0]))))
    assert 0.999 * own < best.cost[0] <= own
    assert best.mean[1, 1] == 0.0  # OOD-1 has m2 = 0.3: the best m2 of [1, 2] is the lowest


@pytest.mark.slow
def test_pendulums_udr_over_a_speck_is_its_lqr():
    """What the mean over starts is for: with nothing to average over, UDR is the policy that
    everyone else uses.
    """
    tiny = PendulumConfig(m1=(1.5, 1.5001), m2=(1.5, 1.5001), b1=(1.5, 1.5001), b2=(1.5, 1.5001))
    problem = pendulum_problem(pendulum_space(tiny))
    out = udr(problem, samples_log2=4, restarts=1)
    with jax.enable_x64(True):
        exact = problem.policy(problem.space.physical(jnp.full(4, 0.5)))
    # The horizon is 2.5 s and not endless, and sums stand for integrals: a few per cent.
    np.testing.assert_allclose(out.policy, exact, rtol=0.05)


def test_scaled_spaces_are_respected():
    assert SPACE.physical(jnp.array([0.25, 0.8])).tolist() == pytest.approx([1.25, 26.0])
