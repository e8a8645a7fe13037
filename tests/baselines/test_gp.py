"""The Gaussian process of BayesOpt: gradients, an interpolation that is known, and that it finds a
maximum.
"""

import numpy as np
from scipy import integrate, optimize, stats

from adaptsim_jax.baselines import bayesopt


def test_the_posteriors_gradient_is_its_slope():
    rng = np.random.default_rng(0)
    x, z = rng.uniform(size=(7, 2)), rng.normal(size=7)
    at = np.array([-0.5, 0.1, 0.3, -1.0])
    slope = optimize.approx_fprime(at, lambda v: bayesopt._cost(v, x, z)[0], 1e-6)
    np.testing.assert_allclose(bayesopt._cost(at, x, z)[1], slope, rtol=1e-4, atol=1e-4)


def test_a_smooth_function_is_interpolated_and_unsure_far_from_its_points():
    x = np.linspace(0.0, 0.5, 8)[:, None]
    found = bayesopt.fit(x, np.sin(6 * x[:, 0]), np.random.default_rng(0))
    mean, spread = bayesopt.predict(found, np.array([[0.23], [1.0]]))
    assert abs(mean[0] - np.sin(6 * 0.23)) < 0.02
    assert spread[1] > 5 * spread[0]


def test_expected_improvement_is_the_integral_that_it_stands_for():
    found = bayesopt.fit(
        np.array([[0.1], [0.5], [0.9]]), np.array([0.0, 1.0, 0.3]), np.random.default_rng(0)
    )
    point, best = np.array([[0.65]]), 0.9
    mean, spread = (float(a[0]) for a in bayesopt.predict(found, point))
    value = integrate.quad(
        lambda f: max(f - best, 0.0) * stats.norm.pdf(f, mean, spread), best, mean + 10 * spread
    )[0]
    np.testing.assert_allclose(
        bayesopt.expected_improvement(found, point, best)[0], value, rtol=1e-6
    )


def test_it_finds_a_maximum_from_few_noisy_values():
    """20 values of a bump in two dimensions, noise a tenth of its height: better than 20 random
    points are in the mean.
    """
    rng = np.random.default_rng(3)

    def bump(u):
        return np.exp(-((u - np.array([0.7, 0.2])) ** 2).sum(-1) / 0.1)

    x = rng.uniform(size=(6, 2))
    y = bump(x) + 0.1 * rng.normal(size=6)
    for _ in range(14):
        u = bayesopt.propose(bayesopt.fit(x, y, rng), rng, candidates=256)
        assert np.all((u >= 0) & (u <= 1))
        x, y = np.vstack([x, u]), np.append(y, bump(u) + 0.1 * rng.normal())
    best = x[bayesopt.predict(bayesopt.fit(x, y, rng), x)[0].argmax()]
    random = np.mean(
        [bump(np.random.default_rng(s).uniform(size=(20, 2))).max() for s in range(200)]
    )
    assert bump(best) > max(0.95, random)
