"""Normalised advantage functions: Q of actions on a continuum, in problems that end after one (Gu
et al. 2016; paper, appendix A4).

`Q(s, a) = V(s) - (a - m(s))' P(s) (a - m(s)) / 2` with `P = L L'`, a full positive-definite matrix:
L is lower triangular with exponentials on its diagonal. Actions live in `[-1, 1]^d`, and the greedy
one is the exact maximiser of Q inside that box (`box_maximiser`), so the mean may lie outside.
Sizes are static (`NAFConfig`), rates traced (`NAFHyper`). All is pure; vmap over states trains
hundreds of networks in one update.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import flax.linen as nn
import jax
import jax.numpy as jnp
import optax

from adaptsim_jax.control.small_matrix import solve
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.learners.bdq import ACTIVATIONS, adam_step, flat

# ---------------------------------------------------------------- the best action in a box
#
# The exact maximiser of a concave quadratic inside a box: what NAF's greedy action is when actions
# have bounds.
#
# Maximise `-(a - mean)' P (a - mean) / 2` with `P = L L'` positive definite over `low <= a <=
# high`. Clipping `mean` is not the answer unless P is diagonal: a bound on one action moves the
# best value of the others.

Array = Any
# per action; 1 settles every one of 10,000 random problems of 3 actions, 4 all but one of 6 actions
ROUNDS = 6


def box_maximiser(mean: Array, chol: Array, low: float = -1.0, high: float = 1.0) -> Array:
    """`[..., d]`: the best action in `[low, high]^d` for `mean [..., d]` and lower-triangular `chol
    [..., d, d]`.

    d = 1 is a clip, d = 2 an enumeration of the active sets, d > 2 an active-set ascent.
    """
    d = mean.shape[-1]
    if d == 1:
        return jnp.clip(mean, low, high)
    precision = _precision(chol)
    if d == 2:
        return _two(mean, precision, low, high)
    return _many(mean, precision, low, high)


def _precision(chol: Array) -> Array:
    """`P = L L'`, summed by hand: a batched product of 2x2 matrices is slow in XLA."""
    return jnp.sum(chol[..., :, None, :] * chol[..., None, :, :], -1)


def _half_square(delta: Array, precision: Array) -> Array:
    """`delta' P delta / 2`, `[...]`."""
    return 0.5 * jnp.sum(delta * jnp.sum(precision * delta[..., None, :], -1), -1)


def _two(mean: Array, precision: Array, low: float, high: float) -> Array:
    """The mean where it lies inside, else the best point of the four edges: on each the other
    action is a clip.
    """
    best, lowest = mean, jnp.where(jnp.all((mean >= low) & (mean <= high), -1), -1.0, jnp.inf)
    for i, j in ((0, 1), (1, 0)):
        slope = precision[..., 0, 1] / precision[..., j, j]
        for bound in (low, high):
            fixed = jnp.full_like(mean[..., i], bound)
            free = jnp.clip(mean[..., j] - slope * (fixed - mean[..., i]), low, high)
            action = jnp.stack((fixed, free) if i == 0 else (free, fixed), -1)
            loss = _half_square(action - mean, precision)
            best = jnp.where((loss < lowest)[..., None], action, best)
            lowest = jnp.minimum(loss, lowest)
    return best


def _many(mean: Array, precision: Array, low: float, high: float) -> Array:
    """Rounds of two monotone moves until the active set settles.

    A sweep of coordinate ascent takes up and lets go of bounds. Then all free actions move together
    to where they would be best with the others held, as far as the first bound that they meet.
    """
    d = mean.shape[-1]

    def sweep(action):
        for i in range(d):
            row = precision[..., i, :]
            slope = jnp.sum(row * (action - mean), -1)
            pull = slope - row[..., i] * (action[..., i] - mean[..., i])
            best = mean[..., i] - pull / row[..., i]
            action = action.at[..., i].set(jnp.clip(best, low, high))
        return action

    def one(_, action):
        action = sweep(action)
        move = _solve_free(action, mean, precision, low, high) - action
        room = jnp.where(move > 0, high - action, low - action)
        share = jnp.where(move == 0, 1.0, room / jnp.where(move == 0, 1.0, move))
        return jnp.clip(action + jnp.minimum(share.min(-1, keepdims=True), 1.0) * move, low, high)

    return jax.lax.fori_loop(0, ROUNDS * d, one, jnp.clip(mean, low, high))


def _solve_free(action: Array, mean: Array, precision: Array, low: float, high: float) -> Array:
    """Stationary point of the actions that touch no bound, the others held: `P_ff (a_f - m_f) =
    -P_fb (b - m_b)`.
    """
    free = (action > low) & (action < high)
    held = jnp.where(free, 0.0, action - mean)
    right = -jnp.sum(precision * held[..., None, :], -1)
    eye = jnp.broadcast_to(jnp.eye(mean.shape[-1], dtype=mean.dtype), precision.shape)
    matrix = jnp.where(free[..., :, None] & free[..., None, :], precision, eye)

    def last(x, n):
        return jnp.moveaxis(x, tuple(range(x.ndim - n)), tuple(range(n - x.ndim, 0)))

    found = solve(last(matrix, 2), last(jnp.where(free, right, 0.0), 1)[:, None])[:, 0]
    return jnp.where(free, mean + jnp.moveaxis(found, 0, -1), action)


@dataclass(frozen=True)
class NAFConfig:
    """Sizes of the network; static under jit. reach: The mean lies in `[-reach, reach]`.
    log_diagonal: The diagonal of L lies in `exp(+-log_diagonal)`.
    """

    obs_dim: int
    action_dim: int
    hidden: tuple[int, ...] = (64, 64)
    activation: str = "relu"
    reach: float = 1.5
    log_diagonal: float = 2.0


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class NAFHyper:
    """Rates of the learner: a pytree, each leaf a scalar, or `[S]` under vmap.

    learning_rate: Adam's. max_grad_norm: The gradient is scaled down to this global norm.
    """

    learning_rate: float = 1e-3
    max_grad_norm: float = 1.0


class NAFState(NamedTuple):
    """What the next update needs. Weights are a flat `[n]` vector."""

    online: jax.Array
    opt: optax.OptState


class NAFInfo(NamedTuple):
    """Of one update: loss, mean Q of the taken actions, gradient norm before clipping; each
    `[]`.
    """

    loss: jax.Array
    q: jax.Array
    grad_norm: jax.Array


class Quadratic(NamedTuple):
    """Q as a function of the action: value `[...]` at mean `[..., d]`, and chol `[..., d, d]`,
    lower triangular.
    """

    value: jax.Array
    mean: jax.Array
    chol: jax.Array

    def __call__(self, action: jax.Array) -> jax.Array:
        """Q of `action [..., d]`: `[...]`."""
        delta = action - self.mean
        whitened = jnp.sum(self.chol * delta[..., :, None], -2)
        return self.value - 0.5 * jnp.sum(jnp.square(whitened), -1)


class QuadraticNetwork(nn.Module):
    """`obs [..., obs_dim] -> Quadratic`."""

    config: NAFConfig

    @nn.compact
    def __call__(self, obs: jax.Array) -> Quadratic:
        cfg, d = self.config, self.config.action_dim
        x = obs
        for width in cfg.hidden:
            x = ACTIVATIONS[cfg.activation](
                nn.Dense(width, kernel_init=nn.initializers.he_uniform())(x)
            )
        # One matrix holds all heads. It starts small, so that P starts near the identity and the
        # mean near the centre.
        heads = nn.Dense(
            1 + d + d * (d + 1) // 2,
            kernel_init=nn.initializers.variance_scaling(0.01, "fan_in", "normal"),
        )(x)
        value = heads[..., 0]
        mean = heads[..., 1 : 1 + d]
        entries = heads[..., 1 + d :]
        return Quadratic(
            value, cfg.reach * jnp.tanh(mean), _lower_triangle(entries, d, cfg.log_diagonal)
        )


class NAF(NamedTuple):
    """The learner as pure functions; see `make_naf`."""

    config: NAFConfig
    init: Callable[[jax.Array], NAFState]
    fresh: Callable[[jax.Array], NAFState]
    quadratic: Callable[[jax.Array, jax.Array], Quadratic]
    greedy: Callable[[jax.Array, jax.Array], jax.Array]
    act: Callable[..., jax.Array]
    update: Callable[..., tuple[NAFState, NAFInfo]]


def make_naf(config: NAFConfig) -> NAF:
    """Check the sizes and return the learner.

    * `init(key) -> NAFState`; `fresh(weights [n]) -> NAFState` starts anew from trained weights
    * `quadratic(weights, obs [..., obs_dim]) -> Quadratic`, `weights` being `state.online`
    * `greedy(weights, obs) -> [..., d]`, the maximiser of Q inside `[-1, 1]^d`
    * `act(key, weights, obs, scale) -> [..., d]`: noise of covariance `scale * inverse(P)` about
      it, clipped into the box
    * `update(state, batch, hyper) -> (NAFState, NAFInfo)`: one Adam step on a `Transition` of `[B,
      ...]`, actions float
    """
    _check(config)
    weights_of, quadratic = flat(QuadraticNetwork(config), config.obs_dim)

    def fresh(weights):
        return NAFState(weights, optax.scale_by_adam().init(weights))

    def init(key):
        return fresh(weights_of(key))

    def greedy(weights, obs):
        q = quadratic(weights, obs)
        return box_maximiser(q.mean, q.chol)

    def act(key, weights, obs, scale):
        q = quadratic(weights, obs)
        best = box_maximiser(q.mean, q.chol)
        return jnp.clip(
            best + jnp.sqrt(scale) * _whiten(q.chol, jax.random.normal(key, best.shape)), -1.0, 1.0
        )

    def update(state, batch, hyper):
        def loss_of(w):
            return _loss(quadratic(w, batch.obs)(batch.action), batch.reward)

        (loss, q), grad = jax.value_and_grad(loss_of, has_aux=True)(state.online)
        online, opt, norm = adam_step(state.online, state.opt, grad, hyper)
        return NAFState(online, opt), NAFInfo(loss, q, norm)

    return NAF(config, init, fresh, quadratic, greedy, act, update)


def _lower_triangle(entries: jax.Array, d: int, log_diagonal: float) -> jax.Array:
    """`[..., d (d + 1) / 2] -> [..., d, d]`: row by row, the diagonal exponentiated between its
    bounds.
    """
    rows, place = [], 0
    for i in range(d):
        row = [entries[..., place + j] for j in range(i)]
        row.append(jnp.exp(log_diagonal * jnp.tanh(entries[..., place + i])))
        row += [jnp.zeros_like(row[0])] * (d - i - 1)
        rows.append(jnp.stack(row, -1))
        place += i + 1
    return jnp.stack(rows, -2)


def _whiten(chol: jax.Array, noise: jax.Array) -> jax.Array:
    """Solve `L' x = noise` by back substitution, so that x has covariance `inverse(L L')`: `[...,
    d]`.
    """
    d = noise.shape[-1]
    x: list[jax.Array] = [noise[..., 0]] * d
    for i in reversed(range(d)):
        rest = sum((chol[..., j, i] * x[j] for j in range(i + 1, d)), jnp.zeros_like(noise[..., i]))
        x[i] = (noise[..., i] - rest) / chol[..., i, i]
    return jnp.stack(x, -1)


def _loss(q: jax.Array, target: jax.Array):
    """Huber's, and the mean of Q."""
    error = q - jax.lax.stop_gradient(target)
    huber = jnp.where(jnp.abs(error) < 1.0, 0.5 * error**2, jnp.abs(error) - 0.5)
    return jnp.mean(huber), q.mean()


def _check(config: NAFConfig) -> None:
    if not config.hidden or min(config.obs_dim, config.action_dim, *config.hidden) < 1:
        raise BadInput(f"NAF sizes {config}: each must be positive, with one hidden layer or more")
    if config.reach < 1.0 or config.log_diagonal <= 0.0:
        raise BadInput(
            f"NAF reach {config.reach} must be at least 1, else the box's corners are out of "
            "reach; log_diagonal positive"
        )
    if config.activation not in ACTIVATIONS:
        raise BadInput(f"NAF activation {config.activation!r} is none of {', '.join(ACTIVATIONS)}")
