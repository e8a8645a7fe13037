"""Proximal policy optimisation for actions on a continuum (Schulman et al. 2017), with advantages
by GAE (2016).

A Gaussian about the policy's output, clipped into `[-1, 1]^d`; a value network of its own.
Observations are standardised by what was seen so far, rewards by the spread of discounted returns.
What a policy may know beside the observation (`extra`) goes to both networks as it is, with weights
that begin at 0: a policy that is told something later goes on from what it did. Sizes are static
(`PPOConfig`), rates traced (`PPOHyper`).
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

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.learners.bdq import ACTIVATIONS, adam_step, flat, held

LOWEST, HIGHEST = -3.0, 0.5  # of the logarithm of the exploration's standard deviation
MAX_DEVIATIONS = (
    100.0  # standard deviations, beyond which a number has no more say in what scales it
)
FIRST = 1024  # of the first numbers, by which it is estimated what is an outlier


@dataclass(frozen=True)
class PPOConfig:
    """Sizes, static under jit. obs_dim: Standardised. extra_dim: What a policy knows beside them;
    epochs x minibatches: Adam steps of an update.
    """

    obs_dim: int
    action_dim: int
    extra_dim: int = 0
    hidden: tuple[int, ...] = (64, 64)
    activation: str = "tanh"
    epochs: int = 4
    minibatches: int = 8


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class PPOHyper:
    """Rates: a pytree, each leaf a scalar, or `[S]` under vmap.

    learning_rate: Adam's. discount: Gamma. trace: Lambda of GAE. clip: How far the ratio of
    probabilities may go. entropy: Bonus on the exploration. value: Weight of the value's loss.
    max_grad_norm: Gradients are scaled down to this global norm.
    """

    learning_rate: float = 1e-3
    discount: float = 0.99
    trace: float = 0.95
    clip: float = 0.2
    entropy: float = 1e-2
    value: float = 0.5
    max_grad_norm: float = 1.0


class RunningScale(NamedTuple):
    """Count, mean and sum of squares about it, of numbers seen so far."""

    count: Array
    mean: Array
    squares: Array

    @classmethod
    def blank(cls, shape: int | tuple[int, ...]) -> "RunningScale":
        return cls(jnp.zeros(()), jnp.zeros(shape), jnp.zeros(shape))

    @property
    def std(self) -> Array:
        return jnp.sqrt(self.squares / jnp.maximum(self.count, 1.0)) + 1e-4


class Actor(NamedTuple):
    """What is deployed: weights `[n]`, mean and standard deviation `[O]` of observations."""

    weights: Array
    mean: Array
    std: Array


class PPOState(NamedTuple):
    """What the next update needs. `gain`: of discounted returns, whose spread scales rewards."""

    weights: Array
    opt: optax.OptState
    obs: RunningScale
    gain: RunningScale


class Unroll(NamedTuple):
    """`T` steps of `B` environments, `[T, B, ...]`: `after` is the observation that a step led to.
    ended: It was the last of its episode, and no reward follows. cut: What follows is another
    episode, but this one would have gone on. carried `[B]`: Discounted rewards of the episode
    before this batch, for the spread of returns.
    """

    obs: Array
    extra: Array
    action: Array
    log_prob: Array
    reward: Array
    after: Array
    ended: Array
    cut: Array
    carried: Array


class PPOInfo(NamedTuple):
    """Of one update, each `[]`: losses, the exploration's standard deviation, and how far the new
    policy is from the old (KL).
    """

    policy_loss: Array
    value_loss: Array
    spread: Array
    kl: Array


class ActorCritic(nn.Module):
    """`[..., O + X] -> mean [..., d], log std [d], value [...]`."""

    config: PPOConfig

    @nn.compact
    def __call__(self, x: Array):
        cfg = self.config

        orthogonal = nn.initializers.orthogonal(np.sqrt(2))

        def first(*args):
            return orthogonal(*args).at[cfg.obs_dim :].set(0.0)

        def mlp(y, outputs, scale):
            for i, width in enumerate(cfg.hidden):
                y = ACTIVATIONS[cfg.activation](
                    nn.Dense(width, kernel_init=orthogonal if i else first)(y)
                )
            return nn.Dense(outputs, kernel_init=nn.initializers.orthogonal(scale))(y)

        log_std = self.param("log_std", nn.initializers.constant(-0.5), (cfg.action_dim,))
        return mlp(x, cfg.action_dim, 0.01), held(log_std, LOWEST, HIGHEST), mlp(x, 1, 1.0)[..., 0]


class PPO(NamedTuple):
    """The learner as pure functions; see `make_ppo`."""

    config: PPOConfig
    init: Callable[[Array], PPOState]
    actor: Callable[[PPOState], Actor]
    deployed: Callable[[Actor, Array, Array], Array]
    value: Callable[[Actor, Array, Array], Array]
    act: Callable[..., tuple[Array, Array]]
    update: Callable[..., tuple[PPOState, PPOInfo]]


def make_ppo(config: PPOConfig) -> PPO:
    """Check the sizes and return the learner.

    * `init(key) -> PPOState`; `actor(state) -> Actor`
    * `deployed(actor, obs [..., O], extra [..., X]) -> [..., d]` in [-1, 1], without noise
    * `value(actor, obs [..., O], extra [..., X]) -> [...]`: what is expected from there on,
      discounted and in scaled rewards
    * `act(key, actor, obs, extra) -> (action [..., d], log_prob [...])`, with the exploration's
      noise, not clipped
    * `update(key, state, batch, hyper) -> (state, info)`: one round of epochs over an `Unroll`
    """
    _check(config)
    weights_of, network = flat(ActorCritic(config), config.obs_dim + config.extra_dim)

    def apply(weights, mean, std, obs, extra):
        lead = (1,) * (obs.ndim - 1)
        scaled = jnp.clip((obs - mean.reshape(*lead, -1)) / std.reshape(*lead, -1), -10.0, 10.0)
        return network(weights, jnp.concatenate([scaled, extra], -1))

    def init(key):
        weights = weights_of(key)
        opt = optax.scale_by_adam().init(weights)
        return PPOState(weights, opt, RunningScale.blank(config.obs_dim), RunningScale.blank(()))

    def actor(state):
        std = jnp.where(state.obs.count > 0, state.obs.std, 1.0)
        return Actor(state.weights, state.obs.mean, std)

    def deployed(actor: Actor, obs, extra):
        return jnp.clip(apply(actor.weights, actor.mean, actor.std, obs, extra)[0], -1.0, 1.0)

    def value(actor: Actor, obs, extra):
        return apply(actor.weights, actor.mean, actor.std, obs, extra)[2]

    def act(key, actor, obs, extra):
        mean, log_std, _ = apply(actor.weights, actor.mean, actor.std, obs, extra)
        std = jnp.exp(log_std).reshape(*(1,) * (mean.ndim - 1), -1)
        action = mean + std * jax.random.normal(key, mean.shape)
        return action, _log_prob(action, mean, log_std)

    def update(key, state, batch, hyper):
        rewards, gain = _scaled(state.gain, batch, hyper.discount)
        before = actor(state)
        values = value(before, batch.obs, batch.extra)
        advantage = gae(rewards, values, value(before, batch.after, batch.extra), batch, hyper)
        steps = (batch.obs, batch.extra, batch.action, batch.log_prob)
        columns = (*steps, advantage, advantage + values)
        rows = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), columns)

        def loss(w, part):
            return _loss(lambda o, e: apply(w, before.mean, before.std, o, e), part, hyper)

        (weights, opt), infos = _epochs(key, config, loss, (state.weights, state.opt), rows, hyper)
        info = jax.tree.map(jnp.mean, infos)
        return PPOState(weights, opt, _more(state.obs, batch.obs), gain), info

    return PPO(config, init, actor, deployed, value, act, update)


def gae(reward: Array, value: Array, after: Array, batch: Unroll, hyper: PPOHyper) -> Array:
    """Advantages `[T, B]` from rewards and values `[T, B]` before and `after` each step (Schulman
    et al. 2016).
    """
    delta = reward + hyper.discount * (1.0 - batch.ended) * after - value
    on = (1.0 - batch.ended) * (1.0 - batch.cut)

    def back(carry, row):
        delta, on = row
        carry = delta + hyper.discount * hyper.trace * on * carry
        return carry, carry

    return jax.lax.scan(back, jnp.zeros_like(delta[0]), (delta, on), reverse=True)[1]


def carried(batch: Unroll, discount: Array | float) -> tuple[Array, Array]:
    """Discounted rewards of an episode so far: at each step `[T, B]`, and what the next batch
    begins with `[B]`.
    """

    def on(total, row):
        reward, over = row
        total = discount * total + reward
        return total * (1.0 - over), total

    over = jnp.maximum(batch.ended, batch.cut)
    rest, every = jax.lax.scan(on, batch.carried, (batch.reward, over))
    return every, rest


def _scaled(gain: RunningScale, batch: Unroll, discount) -> tuple[Array, RunningScale]:
    every, _ = carried(batch, discount)
    gain = _more(gain, every[..., None], last=())
    return jnp.clip(
        batch.reward / jnp.maximum(gain.std, 1e-3), -MAX_DEVIATIONS, MAX_DEVIATIONS
    ), gain


def _more(scale: RunningScale, rows: Array, last: tuple[int, ...] | None = None) -> RunningScale:
    """`scale` with `rows [T, B, n]` added (Chan et al. 1979), as far as they are `_near`."""
    flat_rows = _near(scale, rows.reshape(-1, rows.shape[-1]))
    count, mean = jnp.asarray(flat_rows.shape[0], jnp.float32), flat_rows.mean(0)
    squares = jnp.square(flat_rows - mean[None]).sum(0)
    if last is not None:
        mean, squares = mean.reshape(last), squares.reshape(last)
    total = scale.count + count
    shift = mean - scale.mean
    mean = scale.mean + shift * count / total
    squares = scale.squares + squares + jnp.square(shift) * scale.count * count / total
    return RunningScale(total, mean, squares)


def _near(scale: RunningScale, rows: Array) -> Array:
    """`rows [N, n]` at most `MAX_DEVIATIONS` from the mean. A world that blows up goes to 1e27 before it is no
    number: one such row would hide all else for good. What is rarer than one row in `MAX_DEVIATIONS^2` stays
    far; what is not widens the scale until it is near.
    """  # noqa: E501

    def at_first():
        some = rows[:: max(1, rows.shape[0] // FIRST)]
        middle = jnp.median(some, 0, keepdims=True)
        return middle, jnp.quantile(
            jnp.abs(some - middle), 0.99, 0, keepdims=True
        ) / 2.58  # of a normal one its std

    shape = (1, rows.shape[1])
    centre, std = jax.lax.cond(
        scale.count == 0, at_first, lambda: (scale.mean.reshape(shape), scale.std.reshape(shape))
    )
    return jnp.clip(rows, centre - MAX_DEVIATIONS * std, centre + MAX_DEVIATIONS * std)


def _epochs(key, config: PPOConfig, loss, carry, rows, hyper):
    """Adam steps over all of `rows`, shuffled anew in each epoch."""
    count = rows[-1].shape[0]
    size = count // config.minibatches

    def step(carry, part):
        weights, opt = carry
        (_, info), grad = jax.value_and_grad(loss, has_aux=True)(weights, part)
        grad = jnp.where(jnp.isfinite(grad), grad, 0.0)
        return adam_step(weights, opt, grad, hyper)[:2], info

    def epoch(carry, key):
        order = _shuffled(key, count)[: size * config.minibatches].reshape(config.minibatches, size)
        return jax.lax.scan(
            lambda c, pick: step(c, jax.tree.map(lambda x: x[pick], rows)), carry, order
        )

    return jax.lax.scan(epoch, carry, jax.random.split(key, config.epochs))


def _shuffled(key: Array, count: int) -> Array:
    """0 to `count` - 1 in random order `[count]`, by one sort of random numbers that end in their
    index: on a CPU an eighth of the time of `jax.random.permutation`. Rows whose numbers tie keep
    their order, which matters at the edges of a minibatch alone.
    """
    low = max(1, (count - 1).bit_length())
    head = jax.random.bits(key, (count,), jnp.uint32) >> low << low
    return (jnp.sort(head | jnp.arange(count, dtype=jnp.uint32)) & ((1 << low) - 1)).astype(
        jnp.int32
    )


def _loss(apply, part, hyper: PPOHyper):
    obs, extra, action, old, advantage, goal = part
    mean, log_std, value = apply(obs, extra)
    change = jnp.clip(_log_prob(action, mean, log_std) - old, -20.0, 20.0)
    ratio = jnp.exp(change)
    scaled = (advantage - advantage.mean()) / (advantage.std() + 1e-6)
    clipped = jnp.clip(ratio, 1.0 - hyper.clip, 1.0 + hyper.clip)
    gained = jnp.minimum(ratio * scaled, clipped * scaled).mean()
    wrong = 0.5 * jnp.square(value - goal).mean()
    total = -gained + hyper.value * wrong - hyper.entropy * log_std.sum()
    return total, PPOInfo(-gained, wrong, jnp.exp(log_std).mean(), (ratio - 1.0 - change).mean())


def _log_prob(action, mean, log_std) -> Array:
    log_std = log_std.reshape(*(1,) * (mean.ndim - 1), -1)
    z = (action - mean) / jnp.exp(log_std)
    return (-0.5 * jnp.square(z) - log_std - 0.5 * np.log(2 * np.pi)).sum(-1)


def _check(config: PPOConfig) -> None:
    if (
        not config.hidden
        or min(config.obs_dim, config.action_dim, config.epochs, config.minibatches, *config.hidden)
        < 1
    ):
        raise BadInput(f"PPO sizes {config}: each must be positive, with one hidden layer or more")
    if config.activation not in ACTIVATIONS:
        raise BadInput(f"PPO activation {config.activation!r} is none of {', '.join(ACTIVATIONS)}")
