"""An adaptation policy that is trained by the reward's own gradient through adaptation trajectories
in simulation.

AdaptSim's policy chooses among steps of -delta, 0 and +delta and learns from trials what they earn.
Where the task policy and its rollout are differentiable, simulation also says how the return in the
target changes with the mean of E, so that a network which gives steps of any size is trained by
analytic policy gradient (as Freeman et al. 2021 and Wiedemann et al. 2023 do for control). Phase 2
is AdaptSim's: visits in the target, of which trajectories are seen; the target itself is never
differentiated there.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, cast

import flax.linen as nn
import jax
import jax.numpy as jnp
import optax

from adaptsim_jax.adaptation.phase1 import draw_target
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.learners.flat import flat
from adaptsim_jax.space import gaussian
from adaptsim_jax.tasks.base import Task

# what a slope by a parameter's whole range is held at, so that a target that all but falls does not
# drown others
_STEEPEST = 3.0


@dataclass(frozen=True)
class AnalyticConfig:
    """Sizes, static under jit. trajectories: of adaptation in all; parallel: in one update;
    horizon: steps of each; longest: step, a share of a parameter's range; learning_rate: Adam's at
    the start, it falls to 0 as a cosine; inside: as `Phase1Hyper.inside`.
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


class Steps(nn.Module):
    """`obs [..., obs_dim] -> [..., dim]` in (-1, 1)."""

    hidden: tuple[int, ...]
    dim: int

    @nn.compact
    def __call__(self, obs: jax.Array) -> jax.Array:
        for width in self.hidden:
            obs = nn.elu(nn.Dense(width, kernel_init=nn.initializers.he_uniform())(obs))
        return jnp.tanh(nn.Dense(self.dim, kernel_init=nn.initializers.zeros)(obs))


class State(NamedTuple):
    """What the next update needs. weights: flat `[n]`."""

    key: jax.Array
    weights: jax.Array
    opt: Any


class Info(NamedTuple):
    """Of one update, each `[]`: the loss at the first and at the last visit, means over the finite,
    and the share that were not.
    """

    first: jax.Array
    last: jax.Array
    lost: jax.Array


class Analytic(NamedTuple):
    """See `make_analytic`."""

    config: AnalyticConfig
    init: Callable[[jax.Array], State]
    run: Callable[[State, jax.Array], tuple[State, Info]]
    adapt: Callable[..., jax.Array]


def make_analytic(
    task: Task, loss: Callable[[Any], jax.Array], config: AnalyticConfig = AnalyticConfig()
) -> Analytic:
    """Training and adaptation as pure functions. `loss(trajectory) -> []` is differentiated by the
    mean of E through `task.train` and `task.rollout`; lower is better, and best free of the
    target's own scale (a logarithm).

    * `init(key) -> State`
    * `run(state, numbers [U]) -> (state, info [U])`: updates of these numbers, of `config.updates`
    * `adapt(weights, starts [N, D], target [D], iterations) -> means [N, iterations + 1, D]` (unit
      coordinates; target physical)
    """
    _check(task, config)
    space = task.space
    weights_of, steps = flat(Steps(config.hidden, space.dim), space.dim + task.obs_dim)
    adam = optax.scale_by_adam()

    def trial(u, key, target):
        policy = task.train(key, gaussian(space, u), task.init_policy(key))
        trajectory = task.rollout(key, policy, target)
        return loss(trajectory), task.observe(trajectory)

    def move(weights, u, seen):
        obs = jnp.concatenate([2.0 * u - 1.0, jnp.where(jnp.isfinite(seen), seen, 0.0)])
        return u + config.longest * steps(weights, obs)

    def init(key):
        key, net = jax.random.split(key)
        weights = weights_of(net)
        return State(key, weights, adam.init(weights))

    def trajectory(weights, key, start, target):
        """A surrogate whose derivative by the weights is that of the summed losses, and the losses
        `[horizon + 1]`.

        Losses are linearised about each mean, where slopes that are not finite can be left out and
        steep ones held. What a step changes of later observations is not followed, what it changes
        of later means is.
        """

        def one(u, _):
            at = jax.lax.stop_gradient(u)
            (value, seen), slope = jax.value_and_grad(trial, has_aux=True)(at, key, target)
            fine = jnp.isfinite(value) & jnp.all(jnp.isfinite(slope))
            slope = jnp.where(fine, jnp.clip(slope, -_STEEPEST, _STEEPEST), 0.0)
            after = u + (move(weights, at, seen) - at)
            # clipped in value alone, so that a step out of the box is unlearned
            held = after + jax.lax.stop_gradient(jnp.clip(after, 0.0, 1.0) - after)
            return held, (
                jnp.sum(jax.lax.stop_gradient(slope) * u),
                jnp.where(fine, value, jnp.nan),
            )

        _, (surrogate, losses) = jax.lax.scan(one, start, None, length=config.horizon + 1)
        return surrogate.mean(), losses

    def update(state, number):
        key = jax.random.fold_in(state.key, number)
        keys = jax.random.split(key, config.parallel)

        def total(weights):
            def one(key):
                run_key, start_key, target_key = jax.random.split(key, 3)
                target = draw_target(target_key, task, config.inside)
                return trajectory(weights, run_key, space.sample(start_key), target)

            surrogate, losses = jax.vmap(one)(keys)
            return surrogate.mean(), losses

        grad, losses = jax.grad(total, has_aux=True)(state.weights)
        rate = config.learning_rate * 0.5 * (1.0 + jnp.cos(jnp.pi * number / config.updates))
        change, opt = cast(tuple[jax.Array, Any], adam.update(grad, state.opt))
        info = Info(
            jnp.nanmean(losses[:, 0]), jnp.nanmean(losses[:, -1]), jnp.mean(jnp.isnan(losses))
        )
        return State(state.key, state.weights - rate * change, opt), info

    def run(state, numbers):
        return jax.lax.scan(update, state, numbers)

    def adapt(weights, starts, target, iterations):
        def one(u, _):
            _, seen = trial(u, jax.random.key(0), target)
            return jnp.clip(move(weights, u, seen), 0.0, 1.0), u

        return jax.vmap(lambda u: jax.lax.scan(one, u, None, length=iterations + 1)[1])(starts)

    return Analytic(config, init, run, adapt)


def _check(task: Task, config: AnalyticConfig) -> None:
    if task.space.is_categorical.any():
        raise BadInput(
            f"task '{task.name}': a gradient by a category says nothing; leave categories out of "
            f"Omega"
        )
    if (
        min(config.trajectories, config.parallel, config.horizon) < 1
        or config.trajectories % config.parallel
    ):
        raise BadInput(
            f"{config.trajectories} trajectories of {config.horizon} steps in updates of "
            f"{config.parallel}: give positive numbers, "
            "the last a divisor of the first"
        )
    if not 0.0 < config.longest <= 1.0 or not config.learning_rate > 0.0:
        given = f"longest = {config.longest}, learning_rate = {config.learning_rate}"
        raise BadInput(f"{given}: give a share of the range, such as 0.25, and a rate above 0")
