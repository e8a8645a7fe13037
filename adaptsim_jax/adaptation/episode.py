"""One adaptation trajectory: the inner loop that Algorithms 1 and 2 share."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from adaptsim_jax import space as spaces
from adaptsim_jax.adaptation.guided import Guide
from adaptsim_jax.space import Gaussian
from adaptsim_jax.tasks.base import Task


class Visit(NamedTuple):
    """A distribution tried in the target.

    mean: `[D]` unit coordinates, policy: the task policy trained there, obs: `[D + obs_dim]` as the
    adaptation policy sees it, score: `[]` raw return, reward: `[]` scaled.
    """

    mean: jax.Array
    policy: Any
    obs: jax.Array
    score: jax.Array
    reward: jax.Array


class Episode(NamedTuple):
    """`I` adaptation steps: `I + 1` visits, the start included, and the `[I, D]` actions between
    them.
    """

    mean: jax.Array
    policy: Any
    obs: jax.Array
    score: jax.Array
    reward: jax.Array
    action: jax.Array


def visit(
    key, task: Task, dist: Gaussian, policy, target, reference, obs_noise: jax.Array | float = 0.0
) -> Visit:
    """Train (or fine-tune) the task policy on `dist`, run it in `target: [D]`, look at what came of
    it.
    """
    train_key, run_key, noise_key = jax.random.split(key, 3)
    policy = task.train(train_key, dist, policy)
    return look(run_key, noise_key, task, dist, policy, target, reference, obs_noise)


def look(
    run_key, noise_key, task: Task, dist: Gaussian, policy, target, reference, obs_noise
) -> Visit:
    """Run a trained `policy` in `target: [D]` and look at what came of it."""
    trajectory = task.rollout(run_key, policy, target)
    seen = task.observe(trajectory)
    seen = seen + obs_noise * jax.random.normal(noise_key, seen.shape, seen.dtype)
    obs = jnp.concatenate([2.0 * dist.mean - 1.0, seen])
    return Visit(dist.mean, policy, obs, task.score(trajectory), task.reward(trajectory, reference))


def run_episode(
    key: jax.Array,
    task: Task,
    act: Callable[[jax.Array, jax.Array], jax.Array],
    start: Gaussian,
    policy: Any,
    target: jax.Array,
    *,
    steps: int,
    delta: jax.Array | float,
    shrink: jax.Array | float = 1.0,
    obs_noise: jax.Array | float = 0.0,
    guide: Guide | None = None,
) -> Episode:
    """Adapt `start` to `target: [D]` (physical) for `steps` steps with `act(key, obs) -> action
    [D]`.

    Step i is of `delta shrink^i`. `guide` may lead the trajectory (Phase 1 only).
    """
    reference, whole_key = task.reference(target), key

    # The visit stands once in the program, inside the scan: it is most of what there is to compile.
    # The action after the last visit is computed and dropped.
    def one(carry, xs):
        dist, policy = carry
        key, number = xs
        visit_key, act_key = jax.random.split(key)
        now = visit(visit_key, task, dist, policy, target, reference, obs_noise)
        action = act(act_key, now.obs)
        if guide is not None:
            action = guide(whole_key, act_key, action, dist.mean, target, delta * shrink**number)
        return (spaces.step(task.space, dist, action, delta * shrink**number), now.policy), (
            now,
            action,
        )

    _, (visits, actions) = jax.lax.scan(
        one, (start, policy), (jax.random.split(key, steps + 1), jnp.arange(steps + 1))
    )
    return Episode(*visits, actions[:-1])
