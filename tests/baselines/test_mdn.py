"""The mixture-density network against SciPy, against an analytic posterior, and on a posterior with
two modes.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from adaptsim_jax.baselines import mdn


def random_mixture(key, components=3, dim=2):
    a, b, c = jax.random.split(key, 3)
    factors = jnp.tril(jax.random.normal(b, (components, dim, dim)))
    diagonal = jnp.abs(jnp.diagonal(factors, axis1=1, axis2=2)) + 0.5
    factors = factors.at[:, np.arange(dim), np.arange(dim)].set(diagonal)
    log_weights = jax.nn.log_softmax(jax.random.normal(c, (components,)))
    return mdn.Mixture(log_weights, jax.random.normal(a, (components, dim)), factors)


def test_log_prob_is_scipys():
    mixture = random_mixture(jax.random.key(0))
    points = jax.random.normal(jax.random.key(1), (20, 2))
    ours = jax.vmap(lambda t: mdn.log_prob(mixture, t))(points)
    density = sum(
        np.exp(w) * stats.multivariate_normal(m, np.linalg.inv(L @ L.T)).pdf(np.asarray(points))
        for w, m, L in zip(*(np.asarray(a, np.float64) for a in mixture), strict=True)
    )
    np.testing.assert_allclose(ours, np.log(density), atol=2e-5)  # float32 sums of order 10


def moments(mixture) -> tuple[jax.Array, jax.Array]:
    """Mean `[D]` and covariance `[D, D]` of one mixture (not truncated)."""
    weights = jnp.exp(mixture.log_weights)
    mean = weights @ mixture.means
    roots = jax.vmap(mdn._inverse_transpose)(mixture.factors)
    within = jnp.einsum("k,kij,klj->il", weights, roots, roots)
    offset = mixture.means - mean[None]
    return mean, within + jnp.einsum("k,ki,kj->ij", weights, offset, offset)


def test_samples_have_the_moments():
    mixture = random_mixture(jax.random.key(2))
    draws = np.asarray(mdn.sample(jax.random.key(3), mixture, 40_000))
    mean, covariance = moments(mixture)
    # Five standard errors of 40,000 draws.
    scale = np.sqrt(np.diag(covariance))
    np.testing.assert_array_less(np.abs(draws.mean(0) - mean), 5 * scale / np.sqrt(40_000))
    np.testing.assert_allclose(np.cov(draws.T), covariance, atol=0.05 * scale.max() ** 2)


def linear_gaussian(n, key, noise=0.3):
    """theta ~ N(0.5, 0.2^2 I), x = A theta + noise: the posterior is Gaussian and known."""
    A = np.array([[1.0, 0.5], [-0.3, 1.2], [0.8, -0.7]])
    prior_var, noise_var = 0.04, (noise * 0.2) ** 2
    theta_key, noise_key = jax.random.split(key)
    theta = 0.5 + 0.2 * jax.random.normal(theta_key, (n, 2))
    x = theta @ A.T + np.sqrt(noise_var) * jax.random.normal(noise_key, (n, 3))
    precision = np.eye(2) / prior_var + A.T @ A / noise_var
    covariance = np.linalg.inv(precision)

    def mean(observed):
        return covariance @ (A.T @ observed / noise_var + np.full(2, 0.5) / prior_var)

    return x, theta, mean, covariance


@pytest.fixture(scope="module")
def trained():
    x, theta, mean, covariance = linear_gaussian(8000, jax.random.key(0))
    shift, scale = mdn.standardise(x)
    network = mdn.MixtureNetwork(dim=2, components=2, hidden=(32, 32))
    variables = network.init(jax.random.key(1), jnp.zeros(3))
    run = jax.jit(
        lambda v: mdn.fit(
            jax.random.key(2),
            v,
            lambda v, a, b: -mdn.log_prob(network.apply(v, a), b),
            (x - shift[None]) / scale[None],
            theta,
            mdn.FitConfig(updates=2000, batch=256),
        )
    )
    return run(variables), lambda v, o: network.apply(v, (o - shift) / scale), mean, covariance


def test_posterior_is_the_analytic_one(trained):
    fitted, infer, mean, covariance = trained
    observed, _, _, _ = linear_gaussian(50, jax.random.key(9))
    scale = np.sqrt(np.diag(covariance))
    means, covariances = jax.vmap(lambda o: moments(infer(fitted, o)))(observed)
    exact = np.stack([mean(np.asarray(o)) for o in observed])
    # Within a quarter of a posterior standard deviation on average: what 8,000 samples support.
    assert np.mean(np.abs(means - exact) / scale) < 0.15
    ratio = np.linalg.eigvals(np.linalg.solve(covariance, np.asarray(covariances)))
    assert np.median(np.abs(ratio - 1)) < 0.15
    assert np.sign(covariances[:, 0, 1].mean()) == np.sign(covariance[0, 1])


def test_held_out_loss_is_near_the_exact_posteriors(trained):
    fitted, infer, mean, covariance = trained
    x, theta, _, _ = linear_gaussian(8000, jax.random.key(0))
    exact = -np.mean(
        [
            stats.multivariate_normal(mean(o), covariance).logpdf(t)
            for o, t in zip(x[-800:], theta[-800:], strict=True)
        ]
    )
    density = jax.vmap(lambda o, t: mdn.log_prob(infer(fitted, o), t))(x[-800:], theta[-800:])
    # the same 800 points: what is left is the fit
    assert exact - 0.005 < -np.mean(density) < exact + 0.05


def test_two_modes_are_found():
    """x = (theta - 0.5)^2 + noise leaves the sign open: a component a side, about equally heavy."""
    theta = jax.random.uniform(jax.random.key(0), (4000, 1))
    x = (theta - 0.5) ** 2 + 0.01 * jax.random.normal(jax.random.key(1), (4000, 1))
    network = mdn.MixtureNetwork(dim=1, components=2, hidden=(32, 32))
    variables = network.init(jax.random.key(3), jnp.zeros(1))
    config = mdn.FitConfig(updates=2500)

    def loss(v, a, b):
        return -mdn.log_prob(network.apply(v, a), b)

    shift, scale = mdn.standardise(x)
    fitted = jax.jit(
        lambda v: mdn.fit(
            jax.random.key(4), v, loss, (x - shift[None]) / scale[None], theta, config
        )
    )(variables)
    mixture = network.apply(fitted, (jnp.array([0.09]) - shift) / scale)
    means = np.sort(np.asarray(mixture.means)[:, 0])
    np.testing.assert_allclose(means, [0.2, 0.8], atol=0.03)
    assert np.exp(mixture.log_weights).min() > 0.3
