"""Adaptation trajectories side by side that share task policies through a pool; see `reuse` for the
rules.

The same loop as `episode.run_episode`, for `P` trajectories at once: which policy a visit goes on
from depends on the others, so the trajectories take their steps together.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from adaptsim_jax import space as spaces
from adaptsim_jax.adaptation.episode import Episode, look
from adaptsim_jax.adaptation.guided import Guide
from adaptsim_jax.adaptation.reuse import Pool, ReuseConfig, lend, settle, train_loans
from adaptsim_jax.space import Gaussian
from adaptsim_jax.tasks.base import Task


class Reusing(NamedTuple):
    """episodes `[P, ...]`; pool: after all of them; budgets `[P, I + 1]` int32: trials that each
    visit's policy was trained with; reused `[P, I + 1]` bool: whether it was lent.
    """

    episodes: Episode
    pool: Pool
    budgets: jax.Array
    reused: jax.Array


def run_reusing(
    keys: jax.Array,
    starts: Gaussian,
    policies: Any,
    targets: jax.Array,
    task: Task,
    act: Any,
    pool: Pool,
    config: ReuseConfig,
    *,
    steps: int,
    delta: jax.Array | float,
    shrink: jax.Array | float = 1.0,
    obs_noise: jax.Array | float = 0.0,
    guide: Guide | None = None,
) -> Reusing:
    """Adapt `starts [P]` to `targets [P, D]` (physical) for `steps` steps with `act(key, obs) ->
    action [D]`; step i is of `delta shrink^i`.

    `policies [P, ...]` are untrained: what a visit far from every anchor starts from. `guide` may
    lead trajectories.
    """
    references = jax.vmap(task.reference)(targets)

    def one(carry, number):
        dists, pool = carry
        parts = jax.vmap(lambda k: jax.random.split(jax.random.fold_in(k, number), 4))(keys)
        loan = lend(pool, config, dists.mean, policies)
        trained = train_loans(parts[:, 0], task.train_many, dists, loan, config.together)
        pool = settle(pool, config, dists.mean, trained, loan)

        def see(run, noise, dist, policy, target, best):
            return look(run, noise, task, dist, policy, target, best, obs_noise)

        now = jax.vmap(see)(parts[:, 1], parts[:, 2], dists, trained, targets, references)
        action = jax.vmap(act)(parts[:, 3], now.obs)
        if guide is not None:
            led: Guide = guide

            def lead(k, s, a, m, t):
                return led(k, s, a, m, t, delta * shrink**number)

            action = jax.vmap(lead)(keys, parts[:, 3], action, dists.mean, targets)
        after = jax.vmap(lambda d, a: spaces.step(task.space, d, a, delta * shrink**number))(
            dists, action
        )
        return (after, pool), (now, action, loan.budget, loan.place >= 0)

    (_, pool), found = jax.lax.scan(one, (starts, pool), jnp.arange(steps + 1))
    visits, actions, budgets, reused = jax.tree.map(lambda x: jnp.swapaxes(x, 0, 1), found)
    episode = Episode(
        visits.mean, visits.policy, visits.obs, visits.score, visits.reward, actions[:, :-1]
    )
    return Reusing(episode, pool, budgets, reused)
