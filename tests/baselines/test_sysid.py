"""SysID-Bayes and SysID-Point on a task whose answer is known, and what both promise: E never
leaves Omega.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.baselines.mdn import FitConfig
from adaptsim_jax.baselines.sysid import (
    SysIdConfig,
    make_sysid,
    mixture_estimator,
    point_estimator,
    simulate,
    within_omega,
)
from adaptsim_jax.core.errors import BadInput
from tests.baselines.probe import SPACE, probe_task

CONFIG = SysIdConfig(
    iterations=2,
    simulations=600,
    hidden=(64, 64),
    components=2,
    draws=200,
    first_fit=FitConfig(updates=1000, rate=5e-3),
    next_fit=FitConfig(updates=1000, rate=2e-3),
)


@pytest.fixture(scope="module", params=[mixture_estimator, point_estimator])
def outcome(request):
    task = probe_task()
    targets = jnp.array([SPACE.values(t) for t in task.settings.values()], jnp.float32)
    run = jax.jit(jax.vmap(jax.vmap(make_sysid(task, request.param, CONFIG), (0, None)), (None, 0)))
    return run(jax.random.split(jax.random.key(0), 3), targets)


@pytest.mark.slow
def test_the_target_is_identified(outcome):
    np.testing.assert_allclose(
        outcome[0, :, -1], np.tile([0.3, 0.8], (3, 1)), atol=0.03
    )  # three times the held-out error of either network


def test_starts_at_the_centre_and_visits_one_more_than_iterations(outcome):
    assert outcome.shape == (2, 3, CONFIG.iterations + 1, 2)
    np.testing.assert_array_equal(outcome[:, :, 0], 0.5)


def test_never_leaves_omega(outcome):
    assert np.all((outcome >= 0) & (outcome <= 1))
    # The second target lies a whole range below; that no network extrapolates well is the
    # baseline's own weakness.


@pytest.mark.slow
def test_seeds_differ_and_repeat():
    task, target = probe_task(), jnp.array([1.3, 26.0])
    run = jax.jit(make_sysid(task, point_estimator, CONFIG))
    a, b, c = (
        run(jax.random.key(0), target),
        run(jax.random.key(0), target),
        run(jax.random.key(1), target),
    )
    np.testing.assert_array_equal(a, b)
    assert np.any(np.asarray(a != c))


def test_draws_outside_omega_are_dropped():
    draws = jnp.array([[[0.2, 0.2], [0.4, 0.4], [5.0, 0.5]]])
    dist, share = within_omega(draws, jnp.ones(1, bool), 1e-4)
    np.testing.assert_allclose(dist.mean, [0.3, 0.3], rtol=1e-6)
    np.testing.assert_allclose(dist.std, [0.1, 0.1], rtol=1e-5)
    assert share == pytest.approx(2 / 3)


def test_with_no_draw_inside_the_mean_is_clipped():
    dist, share = within_omega(jnp.array([[[-2.0, 0.4], [-1.0, 1.2]]]), jnp.ones(1, bool), 1e-4)
    np.testing.assert_allclose(dist.mean, [0.0, 0.8], rtol=1e-6)
    assert share == 0.5 * 0


def test_pooled_draws_count_told_iterations_only():
    draws = jnp.array([[[0.2, 0.2]], [[0.4, 0.4]], [[0.9, 0.9]]])
    dist, _ = within_omega(draws, jnp.array([True, True, False]), 1e-4)
    np.testing.assert_allclose(dist.mean, [0.3, 0.3], rtol=1e-6)


@pytest.mark.parametrize("bad", [{"iterations": 0}, {"simulations": 3}, {"components": 0}])
def test_bad_budgets_are_refused(bad):
    with pytest.raises(BadInput, match=next(iter(bad))):
        SysIdConfig(**bad)


def test_simulations_can_share_visits():
    task = probe_task()

    def draw(key, policy, params):
        return jax.random.uniform(key, (2,))

    noisy = replace(task, rollout=draw, observe=lambda drawn: drawn)
    drawn, at = simulate(jax.random.key(0), noisy, None, SysIdConfig(simulations=90, visits=4))
    assert len(np.unique(drawn, axis=0)) == 4 and len(np.unique(at, axis=0)) == 90
    with pytest.raises(BadInput, match="visits = 91"):
        SysIdConfig(simulations=90, visits=91)
