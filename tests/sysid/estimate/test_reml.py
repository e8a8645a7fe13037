"""Restricted maximum likelihood of variance components: its derivatives, its maximum, and covariances at the edge."""

import numpy as np
import pytest
from scipy.optimize import minimize

from adaptsim_jax.sysid.estimate import reml

WINDOWS, ROWS, STATES = 6, 30, 2


def drawn(seed: int, sizes=(1.0, 0.5, 0.0), stray: float = 0.0) -> reml.Terms:
    """Residuals of one sensor and two forces that wander at different rates, of variances `sizes`."""
    rng = np.random.default_rng(seed)
    gap = np.abs(np.subtract.outer(np.arange(ROWS), np.arange(ROWS)))
    force = np.stack([np.exp(-gap / 2.0), np.exp(-gap / 10.0)])
    force = np.repeat(force[:, None], WINDOWS, 1)
    used = np.ones((WINDOWS, ROWS), bool)
    used[-1, ROWS // 2 :] = False
    force *= used[:, :, None] & used[:, None, :]
    jac = np.stack([np.ones(ROWS), np.linspace(-1, 1, ROWS)], -1) * used[..., None]
    cov = sizes[0] * np.eye(ROWS) + sizes[1] * force[0] + sizes[2] * force[1]
    resid = np.linalg.cholesky(cov) @ rng.normal(size=(WINDOWS, ROWS, 1)) + 30.0 * jac @ rng.normal(size=(STATES, 1))
    resid = resid[..., 0] + stray * np.sin(np.arange(ROWS))
    return reml.Terms(resid * used, jac, used[None].astype(float), force, used)


def value(terms: reml.Terms, log: np.ndarray) -> float:
    return reml._evaluated(terms, log).value


def test_the_slope_is_the_derivative_of_the_value():
    terms, at = drawn(1), np.log([1.3, 0.2, 0.05])
    step = 1e-5 * np.eye(3)
    central = [(value(terms, at + d) - value(terms, at - d)) / 2e-5 for d in step]
    np.testing.assert_allclose(reml._evaluated(terms, at).slope, central, rtol=1e-5, atol=1e-5)


def test_the_information_is_what_the_curvature_is_on_average():
    at = np.log([1.0, 0.5, 0.3])
    step = 1e-3 * np.eye(3)
    seen, made = np.zeros((3, 3)), np.zeros((3, 3))
    for seed in range(60):
        point = reml._evaluated(terms := drawn(seed, np.exp(at)), at)
        made += point.information
        slopes = [reml._evaluated(terms, at + d).slope - reml._evaluated(terms, at - d).slope for d in step]
        seen += np.stack(slopes) / 2e-3
    np.testing.assert_allclose(made / 60, seen / 60, rtol=0.15, atol=0.6)


@pytest.mark.slow
@pytest.mark.parametrize("first", [(1.0, 1e-2, 1e-2), (1.0, 1e-7, 1e-7), (0.1, 1e3, 1e3)])
@pytest.mark.parametrize(
    ("sizes", "stray"), [((1.0, 0.5, 0.0), 0.0), ((1.0, 1e-3, 40.0), 0.0), ((1.0, 0.0, 0.0), 300.0)]
)
def test_the_maximum_is_as_high_as_any_that_a_search_without_derivatives_finds(first, sizes, stray):
    terms = drawn(3, sizes, stray)
    low, high = np.log([0.05, 1e-8, 1e-8]), np.log([50.0, 1e12, 1e12])
    found = reml.maximised(terms, np.log(first), low, high).log
    assert np.all(found >= low) and np.all(found <= high)
    starts = [np.log(s) for s in ([1, 1, 1], [1, 1e-3, 10], [1, 10, 1e-3], [1, 1e-6, 1e-6], [1, 1e4, 1e4])]
    options = {"maxiter": 4000, "xatol": 1e-6, "fatol": 1e-8}
    bounds = list(zip(low, high, strict=True))
    searched = [
        minimize(lambda z: value(terms, z), s, method="Nelder-Mead", bounds=bounds, options=options).fun for s in starts
    ]
    assert value(terms, found) < min(searched) + 0.02


def test_a_step_to_where_no_covariance_has_a_factor_is_not_the_end(monkeypatch):
    terms, evaluated, asked = drawn(5, (1.0, 30.0, 0.0)), reml._evaluated, []
    first, low, high = np.log([1.0, 1e-6, 1e-6]), np.log([0.05, 1e-8, 1e-8]), np.log([50.0, 1e12, 1e12])
    free = reml.maximised(terms, first, low, high).log

    def picky(terms, log):
        asked.append(log)
        if len(asked) in (2, 3, 5):
            raise np.linalg.LinAlgError
        return evaluated(terms, log)

    monkeypatch.setattr(reml, "_evaluated", picky)
    found = reml.maximised(terms, first, low, high).log
    assert len(asked) > 5
    assert evaluated(terms, found).value == pytest.approx(evaluated(terms, free).value, abs=0.02)


def test_rows_that_are_not_there_count_for_nothing():
    terms = drawn(4)
    whole = reml.Terms(
        terms.residual[:-1], terms.jac_state[:-1], terms.sensor[:, :-1], terms.force[:, :-1], terms.used[:-1]
    )
    half = ROWS // 2
    last = reml.Terms(
        terms.residual[-1:, :half], terms.jac_state[-1:, :half], terms.sensor[:, -1:, :half],
        terms.force[:, -1:, :half, :half], terms.used[-1:, :half],
    )  # fmt: skip
    at = np.log([1.0, 0.3, 0.1])
    prior = value(whole, at) + value(last, at) - value(terms, at)
    assert prior == pytest.approx(0.0, abs=1e-6)  # the prior on the sensor is zero at one


def test_a_covariance_that_rounding_made_indefinite_is_factored_all_the_same():
    column = np.linspace(0.0, 1.0, 40)[None, :, None]
    cov = 1e13 * column @ np.swapaxes(column, 1, 2) + 1e-4 * np.eye(40)[None]
    cov[0, 3, 3] -= 2e-3
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.cholesky(cov)
    lower = reml.factored(cov)
    assert np.allclose(lower @ np.swapaxes(lower, 1, 2), cov, rtol=1e-6, atol=1e3)
