"""The loop that both system-identification baselines share (paper, section 6; BayesSim, Ramos et
al. 2019).

Each iteration rolls the current policy out once in the target, simulates the same policy at
parameters drawn from the prior (uniform over Omega), fits a network from observation to parameters,
and retrains the policy on what the network infers from the target's observation. The inferred E
stays within Omega.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import flax.linen as nn
import jax
import jax.numpy as jnp
import optax
from jax import Array

from adaptsim_jax.baselines import mdn
from adaptsim_jax.core.errors import BadInput, check_counts
from adaptsim_jax.space import Gaussian
from adaptsim_jax.tasks.base import Task


@dataclass(frozen=True)
class SysIdConfig:
    """Budgets of a SysID baseline. Target rollouts: `iterations + 1` (the last one scores the last
    policy).

    `simulations`: simulated trajectories drawn at each iteration. `noise`: standard deviation added
    to standardised simulated observations. `pool`: average what all iterations inferred instead of
    the newest alone. `visits`: how many different visits (what a rollout draws for itself, such as
    goals) an iteration's simulations share, 0 for one each: an open-loop action that is searched
    for in a dear simulator is then searched for once, and tried at many parameters.
    """

    iterations: int = 10
    simulations: int = 2000
    hidden: tuple[int, ...] = (128, 128)
    components: int = 5
    noise: float = 0.0
    pool: bool = False
    visits: int = 0
    draws: int = 1000
    least_std: float = 1e-4
    first_fit: mdn.FitConfig = field(default_factory=lambda: mdn.FitConfig(updates=2000))
    next_fit: mdn.FitConfig = field(default_factory=lambda: mdn.FitConfig(updates=500, rate=1e-3))

    def __post_init__(self):
        check_counts(self, ("iterations", "simulations", "components", "draws"), "SysID ")
        if not 0 <= self.visits <= self.simulations:
            raise BadInput(
                f"SysID visits = {self.visits}: give 0 to the number of simulations, "
                f"{self.simulations}"
            )
        if self.simulations < 20:
            raise BadInput(
                f"SysID simulations = {self.simulations}: too few to fit a network; give at least "
                "20"
            )


class Estimator(NamedTuple):
    """A network from a standardised observation to parameters: what tells SysID-Bayes and
    SysID-Point apart.

    `init(key, obs_dim) -> variables`, `loss(variables, x [obs], u [D]) -> []`,
    `infer(key, variables, x [obs]) -> draws [n, D]` in unit coordinates, not truncated.
    """

    init: Callable
    loss: Callable
    infer: Callable


class SysIdState(NamedTuple):
    """What the next iteration needs: E, the policy trained on it, the network, the draws kept so
    far `[I, n, D]`.
    """

    dist: Gaussian
    policy: Array
    variables: dict
    collected: Array
    count: Array


def make_sysid(
    task: Task, estimator: Callable[[int, SysIdConfig], Estimator], config: SysIdConfig
) -> Callable:
    """Make the loop for targets of the task's own model.

    Args:
        estimator: `mixture_estimator` or `point_estimator`.

    Returns:
        `adapt(key, target [D] physical) -> means of E [iterations + 1, D]` (unit coordinates, from
        the start at the centre), pure: jit it, and vmap it over keys and targets.
    """
    network = estimator(task.space.dim, config)

    def adapt(key: Array, target: Array) -> Array:
        start_key, first_key, rest_key = jax.random.split(key, 3)
        policy_key, train_key, net_key = jax.random.split(start_key, 3)
        begun = untrained(net_key, policy_key, task, network, config)
        begun = begun._replace(policy=task.train(train_key, begun.dist, begun.policy))

        def iterate(key, state, fit_config):
            real_key, *keys, train_key = jax.random.split(key, 5)
            real = task.observe(task.rollout(real_key, state.policy, target))
            inferred = infer(keys, state, real, task, network, config, fit_config)
            return inferred._replace(policy=task.train(train_key, inferred.dist, state.policy))

        first = iterate(first_key, begun, config.first_fit)

        def one(state, step_key):
            after = iterate(step_key, state, config.next_fit)
            return after, after.dist.mean

        keys = jax.random.split(rest_key, config.iterations - 1)
        _, rest = jax.lax.scan(one, first, keys)
        return jnp.concatenate([begun.dist.mean[None], first.dist.mean[None], rest])

    return adapt


def untrained(
    net_key, policy_key, task: Task, estimator: Estimator, config: SysIdConfig
) -> SysIdState:
    """Before any data of the target: E at the centre of Omega, the policy as the task starts it."""
    D = task.space.dim
    dist = Gaussian(jnp.full(D, 0.5), jnp.full(D, config.least_std))
    variables = estimator.init(net_key, task.obs_dim)
    draws = jax.eval_shape(estimator.infer, net_key, variables, jnp.zeros(task.obs_dim)).shape
    collected = jnp.zeros((config.iterations, *draws))
    return SysIdState(dist, task.init_policy(policy_key), variables, collected, jnp.zeros((), int))


def infer(keys, state: SysIdState, real: Array, task, estimator, config, fit_config) -> SysIdState:
    """E after `real [obs]` was observed of `state.policy` in the target, the policy as it was;
    `keys [3]`.
    """
    data_key, fit_key, infer_key = keys
    x, u = simulate(data_key, task, state.policy, config)
    shift, scale = mdn.standardise(x)
    noise = config.noise * jax.random.normal(jax.random.fold_in(data_key, 1), x.shape)
    variables = mdn.fit(
        fit_key,
        state.variables,
        estimator.loss,
        (x - shift[None]) / scale[None] + noise,
        u,
        fit_config,
    )
    draws = estimator.infer(infer_key, variables, (real - shift) / scale)
    collected = state.collected.at[state.count].set(draws)
    if config.pool:
        used, marked = collected, jnp.arange(collected.shape[0]) <= state.count
    else:
        used, marked = draws[None], jnp.ones(1, bool)
    dist, _ = within_omega(used, marked, config.least_std)
    return SysIdState(dist, state.policy, variables, collected, state.count + 1)


def simulate(key: Array, task: Task, policy, config: SysIdConfig) -> tuple[Array, Array]:
    """Observations `[n, obs]` of one policy at parameters `[n, D]` (unit coordinates) drawn
    uniformly from Omega.
    """
    prior_key, rollout_key = jax.random.split(key)
    u = task.space.sample(prior_key, (config.simulations,))

    def observe(k, one):
        return task.observe(task.rollout(k, policy, task.space.physical(one)))

    keys = jax.random.split(rollout_key, config.visits or config.simulations)
    return jax.vmap(observe)(jnp.resize(keys, (config.simulations,)), u), u


def within_omega(draws: Array, marked: Array, least_std: float) -> tuple[Gaussian, Array]:
    """Gaussian E from posterior draws `[I, n, D]` of the iterations marked in `marked [I]`; also
    the share inside Omega.

    Draws outside the box are dropped (the posterior is truncated to Omega). Where hardly any is
    inside, as with targets far outside of Omega, the mean of all is clipped to the box instead.
    """
    flat = draws.reshape(-1, draws.shape[-1])
    used = jnp.repeat(marked, draws.shape[1])
    inside = jnp.all((flat >= 0.0) & (flat <= 1.0), axis=-1) & used
    share = jnp.sum(inside) / jnp.sum(used)
    few = share < 0.01
    weights = jnp.where(few, used, inside).astype(flat.dtype)
    weights = weights / jnp.sum(weights)
    points = jnp.clip(flat, 0.0, 1.0)
    # With few inside, clip after averaging: clipped draws would all sit on the faces of the box.
    mean = jnp.where(few, jnp.clip(weights @ flat, 0.0, 1.0), weights @ points)
    std = jnp.sqrt(weights @ (points - mean[None]) ** 2)
    return Gaussian(mean, jnp.maximum(std, least_std)), share


def mixture_estimator(dim: int, config: SysIdConfig) -> Estimator:
    """Make the network of SysID-Bayes: a full-covariance mixture over unit coordinates, which
    infers by drawing from it. The policy follows the mean of these draws within Omega.
    """
    network: Any = mdn.MixtureNetwork(dim, config.components, config.hidden)

    def init(key: Array, obs_dim: int) -> Any:
        return network.init(key, jnp.zeros(obs_dim))

    def loss(variables: dict, x: Array, u: Array) -> Array:
        return -mdn.log_prob(network.apply(variables, x), u)

    def infer(key: Array, variables: dict, x: Array) -> Array:
        return mdn.sample(key, network.apply(variables, x), config.draws)

    return Estimator(init, loss, infer)


class PointNetwork(nn.Module):
    """Observation `[obs]` (standardised) to unit coordinates `[dim]`, held within the box by a
    sigmoid.
    """

    dim: int
    hidden: tuple[int, ...] = (128, 128)

    @nn.compact
    def __call__(self, x: Array) -> Array:
        for width in self.hidden:
            x = nn.tanh(nn.Dense(width)(x))
        return nn.sigmoid(nn.Dense(self.dim)(x))


def point_estimator(dim: int, config: SysIdConfig) -> Estimator:
    """Make the network of SysID-Point: smooth-L1 regression, which infers the one point that it
    regresses to. The policy is trained at the newest point.
    """
    network: Any = PointNetwork(dim, config.hidden)

    def init(key: Array, obs_dim: int) -> Any:
        return network.init(key, jnp.zeros(obs_dim))

    def loss(variables: dict, x: Array, u: Array) -> Array:
        return jnp.mean(optax.huber_loss(network.apply(variables, x), u, delta=1.0))

    def infer(key: Array, variables: dict, x: Array) -> Array:
        del key
        return network.apply(variables, x)[None]

    return Estimator(init, loss, infer)
