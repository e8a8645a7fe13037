"""A mixture-density network: full-covariance Gaussian mixtures over parameters, given an
observation.

Bishop, "Mixture density networks" (1994); the inference network of BayesSim (Ramos et al., 2019).
Each component is held by its mean and the lower Cholesky factor of its *precision*, so that a log
density needs no triangular solve.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array

from adaptsim_jax.learners.bdq import held


class Mixture(NamedTuple):
    """A Gaussian mixture: `log_weights [..., K]`, `means [..., K, D]`, `factors [..., K, D, D]`
    (precision = L L^T).
    """

    log_weights: Array
    means: Array
    factors: Array


@dataclass(frozen=True)
class FitConfig:
    """How a network is fitted: Adam with a cosine decay on minibatches drawn with replacement.

    The last `held_out` of the data scores the network every `check_every` updates; the best network
    is kept.
    """

    updates: int = 1000
    batch: int = 128
    rate: float = 2e-3
    clip: float = 5.0
    held_out: float = 0.1
    check_every: int = 50


class MixtureNetwork(nn.Module):
    """Observation `[obs]` (standardised) to a `Mixture` with `components` over `dim` parameters,
    weights floored at 1e-5.
    """

    dim: int
    components: int = 5
    hidden: tuple[int, ...] = (64, 64)

    @nn.compact
    def __call__(self, x: Array) -> Mixture:
        for width in self.hidden:
            x = nn.tanh(nn.Dense(width)(x))
        K, D = self.components, self.dim
        rows, cols = np.tril_indices(D, -1)
        heads = nn.Dense(K * (1 + 2 * D + len(rows)))(x).reshape(K, -1)
        weights = (nn.softmax(heads[:, 0]) + 1e-5) / (1.0 + K * 1e-5)
        # Means start spread over the unit box, so that no component is born far from the
        # parameters.
        if K > 1:
            start = np.linspace(0.2, 0.8, K)[:, None]
        else:
            start = np.full((1, 1), 0.5)
        means = heads[:, 1 : 1 + D] + jnp.asarray(start, x.dtype)
        log_diagonal = heads[:, 1 + D : 1 + 2 * D] + np.log(4.0)
        diagonal = jnp.exp(held(log_diagonal, -3.0, 8.0))
        factors = jnp.zeros((K, D, D), x.dtype)
        factors = factors.at[:, rows, cols].set(heads[:, 1 + 2 * D :])
        factors = factors.at[:, np.arange(D), np.arange(D)].set(diagonal)
        return Mixture(jnp.log(weights), means, factors)


def log_prob(mixture: Mixture, theta: Array) -> Array:
    """Log density `[]` of one mixture at `theta [D]`."""
    whitened = jnp.einsum("kij,ki->kj", mixture.factors, theta[None] - mixture.means)
    log_det = jnp.sum(jnp.log(jnp.diagonal(mixture.factors, axis1=-2, axis2=-1)), axis=-1)
    constant = 0.5 * theta.shape[-1] * np.log(2 * np.pi)
    return jax.nn.logsumexp(
        mixture.log_weights + log_det - 0.5 * jnp.sum(whitened**2, -1) - constant
    )


def sample(key: Array, mixture: Mixture, n: int) -> Array:
    """Draw `[n, D]` from one mixture."""
    pick_key, noise_key = jax.random.split(key)
    picked = jax.random.categorical(pick_key, mixture.log_weights, shape=(n,))
    noise = jax.random.normal(noise_key, (n, mixture.means.shape[-1]), mixture.means.dtype)
    covariance_roots = jax.vmap(_inverse_transpose)(mixture.factors)
    return mixture.means[picked] + jnp.einsum("nij,nj->ni", covariance_roots[picked], noise)


def _inverse_transpose(factor: Array) -> Array:
    identity = jnp.eye(factor.shape[-1], dtype=factor.dtype)
    return jax.scipy.linalg.solve_triangular(factor, identity, lower=True).T


def fit(
    key: Array,
    variables: dict,
    loss: Callable[[dict, Array, Array], Array],
    x: Array,
    theta: Array,
    config: FitConfig,
) -> dict:
    """Fit `variables` to pairs `x [n, obs]`, `theta [n, D]` by minimising the mean of
    `loss(variables, x_i, theta_i)`.

    Pure, jit- and vmap-able: any network whose loss is per sample will do (mixture or point
    regression).
    """
    training = x.shape[0] - max(int(config.held_out * x.shape[0]), 1)
    checks = max(config.updates // config.check_every, 1)
    schedule = optax.cosine_decay_schedule(config.rate, checks * config.check_every, alpha=0.01)
    optimiser = optax.chain(optax.clip_by_global_norm(config.clip), optax.adam(schedule))

    def mean_loss(v, a, b):
        return jnp.mean(jax.vmap(lambda p, q: loss(v, p, q))(a, b))

    def update(carry, step_key):
        v, opt = carry
        rows = jax.random.randint(step_key, (config.batch,), 0, training)
        gradient = jax.grad(mean_loss)(v, x[rows], theta[rows])
        change, opt = optimiser.update(gradient, opt, v)
        return (optax.apply_updates(v, change), opt), None

    def check(carry, check_key):
        state, best, best_loss = carry
        state, _ = jax.lax.scan(update, state, jax.random.split(check_key, config.check_every))
        now = mean_loss(state[0], x[training:], theta[training:])
        better = now < best_loss  # a NaN is never better
        best = jax.tree.map(lambda a, b: jnp.where(better, a, b), state[0], best)
        return (state, best, jnp.where(better, now, best_loss)), None

    start = (variables, optimiser.init(variables))
    first = jnp.asarray(jnp.inf, x.dtype)
    keys = jax.random.split(key, checks)
    (_, best, _), _ = jax.lax.scan(check, (start, variables, first), keys)
    return best


def standardise(x: Array) -> tuple[Array, Array]:
    """Shift and scale `[obs]` of data `[n, obs]`; a channel that hardly varies is scaled by a small
    floor, not by zero.
    """
    spread = jnp.std(x, axis=0)
    return jnp.mean(x, axis=0), jnp.maximum(spread, 1e-3 * jnp.max(spread) + 1e-8)
