"""An adaptation policy that is trained by the reward's own gradient through adaptation trajectories
in simulation.

AdaptSim's policy chooses among steps of -delta, 0 and +delta and learns from trials what they earn.
Where the task policy and its rollout are differentiable, simulation also says how the return in the
target changes with the mean of E. A network which gives steps of any size is then trained by
analytic policy gradient, as Freeman et al. (2021) and Wiedemann et al. (2023) do for control. Phase
2 is AdaptSim's: visits in the target, of which trajectories are observed. The target itself is
never differentiated there.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, cast

import flax.linen as nn
import jax
import jax.numpy as jnp
import optax
from jax import Array

from adaptsim_jax.adaptation.phase1 import draw_target
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.learners.bdq import flat
from adaptsim_jax.space import gaussian
from adaptsim_jax.tasks.base import Task

_STEEPEST = 3.0
"""What a slope by a parameter's whole range is held at, so that a target that all but falls does not
drown others.
"""  # noqa: E501


@dataclass(frozen=True)
class AnalyticConfig:
    """Sizes, static under jit. trajectories: Of adaptation in all. parallel: In one update.
    horizon: Steps of each. longest: Step, a share of a parameter's range; learning_rate: Adam's at
    the start, it falls to 0 as a cosine. inside: As `Phase1Hyper.inside`.
    """

    trajectories: int = 20_000
    parallel: int = 100
    horizon: int = 10
    hidden: tuple[int, ...] = (128, 128)
    longest: float = 0.25
    learning_rate: float = 2e-3
    inside: float = 0.5

    @property
    def updates(self) -> int:
        return self.trajectories // self.parallel


class StepNetwork(nn.Module):
    """`obs [..., obs_dim] -> [..., dim]` in (-1, 1)."""

    hidden: tuple[int, ...]
    dim: int

    @nn.compact
    def __call__(self, obs: Array) -> Array:
        for width in self.hidden:
            obs = nn.elu(nn.Dense(width, kernel_init=nn.initializers.he_uniform())(obs))
        return jnp.tanh(nn.Dense(self.dim, kernel_init=nn.initializers.zeros)(obs))


class AnalyticState(NamedTuple):
    """What the next update needs. weights: Flat `[n]`."""

    key: Array
    weights: Array
    opt: Any


class AnalyticInfo(NamedTuple):
    """Of one update, each `[]`: the loss at the first and at the last visit, means over the finite,
    and the share that were not.
    """

    first: Array
    last: Array
    lost: Array


class Analytic:
    """Training and adaptation as pure functions.

    `loss(trajectory) -> []` is differentiated by the mean of E through `task.train` and
    `task.rollout`. Lower is better, and best free of the target's own scale (a logarithm).
    """

    def __init__(
        self,
        task: Task,
        loss: Callable[[Any], Array],
        config: AnalyticConfig = AnalyticConfig(),
    ):
        _check(task, config)
        self.task, self.loss, self.config = task, loss, config
        network = StepNetwork(config.hidden, task.space.dim)
        self._weights_of, self._steps = flat(network, task.space.dim + task.obs_dim)
        self._adam = optax.scale_by_adam()

    def init(self, key: Array) -> AnalyticState:
        """Before the first update."""
        key, net = jax.random.split(key)
        weights = self._weights_of(net)
        return AnalyticState(key, weights, self._adam.init(weights))

    def run(self, state: AnalyticState, numbers: Array) -> tuple[AnalyticState, AnalyticInfo]:
        """Updates of these `numbers [U]`, of `config.updates`."""
        return jax.lax.scan(self._update, state, numbers)

    def adapt(self, weights: Array, starts: Array, target: Any, iterations: int):
        """Means `[N, iterations + 1, D]` (unit coordinates) from `starts [N, D]` in `target [D]`
        (physical).
        """

        def one(u, key):
            _, obs = self._trial(u, key, target)
            return jnp.clip(self._move(weights, u, obs), 0.0, 1.0), u

        keys = jax.random.split(jax.random.key(0), iterations + 1)
        return jax.vmap(lambda u: jax.lax.scan(one, u, keys)[1])(starts)

    def _trial(self, u, key, target):
        task, (init_key, train_key, run_key) = self.task, jax.random.split(key, 3)
        policy = task.train(train_key, gaussian(task.space, u), task.init_policy(init_key))
        trajectory = task.rollout(run_key, policy, target)
        return self.loss(trajectory), task.observe(trajectory)

    def _move(self, weights, u, obs):
        whole = jnp.concatenate([2.0 * u - 1.0, jnp.where(jnp.isfinite(obs), obs, 0.0)])
        return u + self.config.longest * self._steps(weights, whole)

    def _trajectory(self, weights, key, start, target):
        """A surrogate whose derivative by the weights is that of the summed losses, and the losses
        `[horizon + 1]`.

        Losses are linearised about each mean, where slopes that are not finite can be left out and
        steep ones held. What a step changes of later observations is not followed, what it changes
        of later means is.
        """

        def one(u, key):
            at = jax.lax.stop_gradient(u)
            by_mean = jax.value_and_grad(self._trial, has_aux=True)
            (value, obs), slope = by_mean(at, key, target)
            fine = jnp.isfinite(value) & jnp.all(jnp.isfinite(slope))
            slope = jnp.where(fine, jnp.clip(slope, -_STEEPEST, _STEEPEST), 0.0)
            after = u + (self._move(weights, at, obs) - at)
            # clipped in value alone, so that a step out of the box is unlearned
            held = after + jax.lax.stop_gradient(jnp.clip(after, 0.0, 1.0) - after)
            linear = jnp.sum(jax.lax.stop_gradient(slope) * u)
            return held, (linear, jnp.where(fine, value, jnp.nan))

        keys = jax.random.split(key, self.config.horizon + 1)
        _, (surrogate, losses) = jax.lax.scan(one, start, keys)
        return surrogate.mean(), losses

    def _total(self, weights, keys):
        """Of trajectories from fresh starts to fresh targets."""

        def one(key):
            run_key, start_key, target_key = jax.random.split(key, 3)
            target = draw_target(target_key, self.task, self.config.inside)
            start = self.task.space.sample(start_key)
            return self._trajectory(weights, run_key, start, target)

        surrogate, losses = jax.vmap(one)(keys)
        return surrogate.mean(), losses

    def _update(self, state: AnalyticState, number: Array) -> tuple[AnalyticState, AnalyticInfo]:
        config = self.config
        keys = jax.random.split(jax.random.fold_in(state.key, number), config.parallel)
        grad, losses = jax.grad(self._total, has_aux=True)(state.weights, keys)
        rate = config.learning_rate * 0.5 * (1.0 + jnp.cos(jnp.pi * number / config.updates))
        change, opt = cast(tuple[Array, Any], self._adam.update(grad, state.opt))
        ends = jnp.nanmean(losses[:, 0]), jnp.nanmean(losses[:, -1])
        info = AnalyticInfo(*ends, jnp.mean(jnp.isnan(losses)))
        return AnalyticState(state.key, state.weights - rate * change, opt), info


def _check(task: Task, config: AnalyticConfig) -> None:
    if task.space.is_categorical.any():
        raise BadInput(
            f"task '{task.name}': a gradient by a category says nothing; leave categories out of "
            "Omega"
        )
    sizes = (config.trajectories, config.parallel, config.horizon)
    if min(sizes) < 1 or config.trajectories % config.parallel:
        raise BadInput(
            f"{config.trajectories} trajectories of {config.horizon} steps in updates of "
            f"{config.parallel}: give positive numbers, the last a divisor of the first"
        )
    if not 0.0 < config.longest <= 1.0 or not config.learning_rate > 0.0:
        given = f"longest = {config.longest}, learning_rate = {config.learning_rate}"
        raise BadInput(f"{given}: give a share of the range, such as 0.25, and a rate above 0")
