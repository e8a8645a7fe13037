"""One adaptation trajectory: the inner loop that Algorithms 1 and 2 share; and how Phase 1 may lead it
towards its target, for the adaptation policy to learn from where it comes.

Steps of single parameters, chosen for what they earn at once, end where parameters make up for each
other's errors; random exploration seldom leaves such places. In simulation the target's parameters
are known, so some trajectories may be walked towards them. Only what is tried changes: rewards are
the task's, and Phase 2 knows nothing of it.
"""  # noqa: E501

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from adaptsim_jax import space as spaces
from adaptsim_jax.learners.bdq import explore
from adaptsim_jax.space import MINUS, PLUS, STAY, Gaussian, Space
from adaptsim_jax.tasks.base import Task

_ASTRAY = 0.3
"""Share of a led trajectory's steps of single parameters that are random: others get a value, too."""  # noqa: E501


class Guide(NamedTuple):
    """share: of trajectories that are led; space: Omega."""

    share: float
    space: Space

    def __call__(self, trajectory_key, step_key, action, mean, target, size) -> Array:
        """The action `[D]` to take at `mean [D]` (unit coordinates) with steps of `size`: `action`,
        or one towards `target [D]` (physical), as `trajectory_key` has it for all of a trajectory.
        """
        led = jax.random.uniform(jax.random.fold_in(trajectory_key, 1)) < self.share
        best = heading(self.space, mean, target, size)
        towards = explore(jax.random.fold_in(step_key, 1), best, 3, _ASTRAY, 1.0)
        return jnp.where(led, towards, action)


def heading(space: Space, mean: Array, target: Array, size: Array | float) -> Array:
    """`[D]` int32: the action that brings `mean [D]` nearer to `target [D]` (physical; its nearest
    point of Omega).
    """
    gap = jnp.clip(space.unit(target), 0.0, 1.0) - mean
    return jnp.where(jnp.abs(gap) < size / 2, STAY, jnp.where(gap < 0, MINUS, PLUS)).astype(
        jnp.int32
    )


class Visit(NamedTuple):
    """A distribution tried in the target.

    mean: `[D]` unit coordinates, policy: The task policy trained there, obs: `[D + obs_dim]` as the
    adaptation policy has it, score: `[]` raw return, reward: `[]` scaled.
    """

    mean: Array
    policy: Any
    obs: Array
    score: Array
    reward: Array


class AdaptationEpisode(NamedTuple):
    """`I` adaptation steps: `I + 1` visits, the start included, and the `[I, D]` actions between
    them.
    """

    mean: Array
    policy: Any
    obs: Array
    score: Array
    reward: Array
    action: Array


class StepPlan(NamedTuple):
    """How an adaptation goes: `steps` of them, the i-th of `delta shrink^i`, a share of Omega's
    ranges. noise: Standard deviation of what is added to observations. guide: May lead it (both in
    Phase 1 only).
    """

    steps: int = 10
    delta: Array | float = 0.1
    shrink: Array | float = 1.0
    noise: Array | float = 0.0
    guide: Guide | None = None

    def size(self, number: Array) -> Array:
        """Of the step after visit `number`."""
        return self.delta * self.shrink**number


class PolicyTrial(NamedTuple):
    """A trained policy in a target: E, the policy, physical values `[D]` of the target, and what
    its reward is scaled by.
    """

    dist: Gaussian
    policy: Any
    target: Array
    reference: Any


def look(run_key, noise_key, task: Task, attempt: PolicyTrial, noise: Array | float = 0.0) -> Visit:
    """Run the policy in its target and look at what came of it."""
    dist, policy, target, reference = attempt
    trajectory = task.rollout(run_key, policy, target)
    whole = as_seen(noise_key, dist.mean, task.observe(trajectory), noise)
    score, reward = task.score(trajectory), task.reward(trajectory, reference)
    return Visit(dist.mean, policy, whole, score, reward)


def as_seen(key: Array, mean: Array, obs: Array, noise: Array | float = 0.0) -> Array:
    """`[D + obs_dim]`, what the adaptation policy is given of `obs [obs_dim]` at E's `mean [D]`."""
    obs = obs + noise * jax.random.normal(key, obs.shape, obs.dtype)
    return jnp.concatenate([2.0 * mean - 1.0, obs])


def run_episode(
    key: Array,
    task: Task,
    act: Callable[[Array, Array], Array],
    start: Gaussian,
    policy: Any,
    target: Array,
    plan: StepPlan,
) -> AdaptationEpisode:
    """Adapt `start` to `target: [D]` (physical) with `act(key, obs) -> action [D]`."""
    reference, whole_key = task.reference(target), key

    # The visit stands once in the program, inside the scan: it is most of what there is to compile.
    # The action after the last visit is computed and dropped.
    def one(carry, xs):
        dist, policy = carry
        key, number = xs
        visit_key, act_key = jax.random.split(key)
        train_key, run_key, noise_key = jax.random.split(visit_key, 3)
        policy = task.train(train_key, dist, policy)
        attempt = PolicyTrial(dist, policy, target, reference)
        now = look(run_key, noise_key, task, attempt, plan.noise)
        action, size = act(act_key, now.obs), plan.size(number)
        if plan.guide is not None:
            action = plan.guide(whole_key, act_key, action, dist.mean, target, size)
        return (spaces.step(task.space, dist, action, size), policy), (now, action)

    rows = (jax.random.split(key, plan.steps + 1), jnp.arange(plan.steps + 1))
    _, (visits, actions) = jax.lax.scan(one, (start, policy), rows)
    return AdaptationEpisode(*visits, actions[:-1])
