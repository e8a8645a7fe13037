"""Branching dueling Q-network with Double-Q targets (Tavakoli et al. 2018; paper, section 4.1).

One trunk, one state value, one advantage per parameter and bin: `Q_d(s, a) = V(s) + A_d(s, a) -
mean_a A_d(s, a)`. The target of every branch is the same, `r + discount * mean_d Q_d^-(s', argmax_a
Q_d(s', a))`, where `Q^-` is the slowly moving copy. Sizes are static (`BDQConfig`); rates are
traced (`BDQHyper`), so that one compiled step serves a sweep.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array
from jax.flatten_util import ravel_pytree

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.learners.replay import Transition

# ---------------------------------------------------------------- flat weights
#
# A flax network over one flat vector of weights, so that rings, archives and checkpoints hold plain
# arrays.


def flat(network: nn.Module, obs_dim: int) -> tuple[Callable[[Array], Array], Callable]:
    """`init(key) -> weights [n]` and `apply(weights, obs [..., obs_dim])` of a network."""
    example = jnp.zeros((1, obs_dim))
    # shapes only: running the initialisation here would compile it operation by operation
    shapes = jax.eval_shape(network.init, jax.random.key(0), example)
    unravel = ravel_pytree(jax.tree.map(lambda x: np.zeros(x.shape, x.dtype), shapes))[1]
    return lambda key: ravel_pytree(network.init(key, example))[
        0
    ], lambda weights, obs: network.apply(unravel(weights), obs)


def adam_step(weights: Array, opt: Any, grad: Array, hyper: Any) -> tuple[Any, Any, Any]:
    """One step of Adam from a gradient that is scaled down to `hyper.max_grad_norm`.

    Returns:
        Weights `[n]`, the optimiser's state, and the gradient's norm before it was scaled.
    """
    norm = optax.tree.norm(grad)
    grad = grad * jnp.minimum(1.0, hyper.max_grad_norm / jnp.maximum(norm, 1e-12))
    move, opt = optax.scale_by_adam().update(grad, opt)
    return weights - hyper.learning_rate * move, opt, norm


@partial(jax.custom_vjp, nondiff_argnums=(1, 2))
def held(x: Array, low: float, high: float) -> Array:
    """`x` clipped, with a gradient beyond the bounds that leads back to them: what only clips never
    comes back.
    """
    return jnp.clip(x, low, high)


def _held_back(low: float, high: float, x: Array, slope: Array) -> tuple[Array]:
    outwards = ((x < low) & (slope > 0)) | ((x > high) & (slope < 0))  # a descent follows -slope
    return (jnp.where(outwards, 0.0, slope),)


held.defvjp(lambda x, low, high: (jnp.clip(x, low, high), x), _held_back)


ACTIVATIONS: dict[str, Callable[[Array], Array]] = {
    "elu": nn.elu,
    "relu": nn.relu,
    "silu": nn.silu,
    "tanh": jnp.tanh,
}


@dataclass(frozen=True)
class BDQConfig:
    """Sizes of the network, static under jit."""

    obs_dim: int
    branches: int
    bins: int = 3
    hidden: tuple[int, ...] = (128, 128)
    activation: str = "elu"
    layer_norm: bool = False


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class BDQHyper:
    """Rates of the learner: a pytree, each leaf a scalar, or `[S]` under vmap over a sweep.

    learning_rate: Adam's. discount: Gamma. tau: Share of the online network that enters the target
    network at each update. max_grad_norm: The gradient is scaled down to this global norm.
    """

    learning_rate: float = 2e-3
    discount: float = 0.7
    tau: float = 0.01
    max_grad_norm: float = 1.0


class BDQState(NamedTuple):
    """What the next update needs. Weights are flat `[n]` vectors: one fused update instead of one
    for each layer.
    """

    online: Array
    target: Array
    opt: optax.OptState


class BDQInfo(NamedTuple):
    """Of one update: loss, mean Q of the taken actions, gradient norm before clipping; each
    `[]`.
    """

    loss: Array
    q: Array
    grad_norm: Array


class BranchingNetwork(nn.Module):
    """`obs [..., obs_dim] -> Q [..., branches, bins]`."""

    config: BDQConfig

    @nn.compact
    def __call__(self, obs: Array) -> Array:
        cfg = self.config
        x = obs
        for width in cfg.hidden:
            x = nn.Dense(width, kernel_init=nn.initializers.he_uniform())(x)
            x = nn.LayerNorm()(x) if cfg.layer_norm else x
            x = ACTIVATIONS[cfg.activation](x)
        # All heads are linear in the trunk, so one matrix holds them; dueling is applied to its
        # columns.
        heads = nn.Dense(1 + cfg.branches * cfg.bins, kernel_init=nn.initializers.lecun_uniform())(
            x
        )
        value, advantage = heads[..., :1, None], heads[..., 1:]
        advantage = advantage.reshape(*advantage.shape[:-1], cfg.branches, cfg.bins)
        return value + advantage - advantage.mean(-1, keepdims=True)


class BDQ(NamedTuple):
    """The learner as pure functions; see `make_bdq`."""

    config: BDQConfig
    init: Callable[[Array], BDQState]
    q_values: Callable[[Array, Array], Array]
    greedy: Callable[[Array, Array], Array]
    act: Callable[..., Array]
    update: Callable[..., tuple[BDQState, BDQInfo]]


def make_bdq(config: BDQConfig) -> BDQ:
    """Check the sizes and return the learner.

    * `init(key) -> BDQState`
    * `q_values(weights, obs [..., obs_dim]) -> [..., branches, bins]`, `weights` being
      `state.online` or `.target`
    * `greedy(weights, obs) -> [..., branches]` int32
    * `act(key, weights, obs, epsilon, independent) -> [..., branches]`: epsilon-greedy, see
      `explore`
    * `update(state, batch, hyper) -> (BDQState, BDQInfo)`: one Adam step on a `Transition` of `[B,
      ...]`
    """
    _check(config)
    weights_of, q_values = flat(BranchingNetwork(config), config.obs_dim)

    def init(key):
        online = weights_of(key)
        return BDQState(online, online, optax.scale_by_adam().init(online))

    def greedy(weights, obs):
        return jnp.argmax(q_values(weights, obs), -1).astype(jnp.int32)

    def act(key, weights, obs, epsilon, independent=0.0):
        return explore(key, greedy(weights, obs), config.bins, epsilon, independent)

    def update(state, batch, hyper):
        target = double_q_target(q_values, state, batch, hyper.discount)
        (loss, q), grad = jax.value_and_grad(_loss, argnums=1, has_aux=True)(
            q_values, state.online, batch, target
        )
        online, opt, norm = adam_step(state.online, state.opt, grad, hyper)
        slow = state.target + hyper.tau * (online - state.target)
        return BDQState(online, slow, opt), BDQInfo(loss, q, norm)

    return BDQ(config, init, q_values, greedy, act, update)


def explore(
    key: Array,
    action: Array,
    bins: int,
    epsilon: Array | float,
    independent: Array | float = 0.0,
) -> Array:
    """With probability epsilon replace a whole action `[..., branches]` by a uniform one.

    With `independent` 1 every branch tosses its own coin: a branch is then mostly valued beside
    greedy neighbours, which is what it will meet when the policy is used.
    """
    coin, noise = jax.random.split(key)
    random = jax.random.randint(noise, action.shape, 0, bins, action.dtype)
    tosses = jax.random.uniform(coin, action.shape)
    tosses = jnp.where(independent > 0, tosses, tosses[..., :1])
    return jnp.where(tosses < epsilon, random, action)


def taken(q: Array, action: Array) -> Array:
    """Q of the chosen bins: `[..., branches, bins]`, `[..., branches]` -> `[..., branches]`."""
    return jnp.take_along_axis(q, action[..., None], -1)[..., 0]


def double_q_target(q_values, state: BDQState, batch: Transition, discount: Array) -> Array:
    """`[B]`: the online network chooses in each branch, the target network values, branches are
    averaged.
    """
    best = jnp.argmax(q_values(state.online, batch.next_obs), -1)
    value = taken(q_values(state.target, batch.next_obs), best).mean(-1)
    return batch.reward + discount * batch.bootstrap * value


def _loss(q_values, weights, batch: Transition, target):
    q = taken(q_values(weights, batch.obs), batch.action)
    return jnp.mean(jnp.square(q - target[:, None])), q.mean()


def _check(config: BDQConfig) -> None:
    if (
        min(config.obs_dim, config.branches, *config.hidden) < 1
        or config.bins < 2
        or not config.hidden
    ):
        raise BadInput(
            f"BDQ sizes {config}: each must be positive, with two bins or more and one hidden "
            "layer or more"
        )
    if config.activation not in ACTIVATIONS:
        raise BadInput(f"BDQ activation {config.activation!r} is none of {', '.join(ACTIVATIONS)}")
