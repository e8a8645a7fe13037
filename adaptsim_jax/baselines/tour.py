"""Phase 2 in an arena: what AdaptSim visits in every target, for every seed and start, and what it
would deploy after each visit.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.adaptation.phase1 import Archive, Phase1, Phase1Hyper
from adaptsim_jax.baselines.arena import Arena, Lanes, Progress
from adaptsim_jax.baselines.memory import Memory
from adaptsim_jax.core.progress import silent
from adaptsim_jax.space import gaussian, step


class Tour(NamedTuple):
    """Of `B` lanes and `I + 1` visits: means `[B, I + 1, D]` (unit coordinates), obs `[B, I + 1, D
    + obs_dim]` as the adaptation policy saw them, actions `[B, I + 1, D]` that it took then, the
    last of which is not done; scores and rewards `[B, I + 1]`, raw returns of the visits and
    rewards of what is deployed; policies as trained, a `[B, ...]` a visit; memory: of all trials.
    """

    means: np.ndarray
    obs: np.ndarray
    actions: np.ndarray
    scores: np.ndarray
    rewards: np.ndarray
    policies: list[Any]
    memory: Memory


def tour(
    arena: Arena,
    batch: Lanes,
    phase1: Phase1,
    weights: jax.Array,
    hyper: Phase1Hyper,
    first: Archive,
    iterations: int,
    report: Progress = silent,
) -> Tour:
    """Greedy steps (paper, Algorithm 2) from `first [B, ...]` with the adaptation policies `weights
    [B, n]`; `hyper`: leaves `[B]`.
    """
    space, memory = phase1.task.space, Memory(arena, batch, iterations + 1)

    @jax.jit
    def advance(mean, obs, number):
        seen = jnp.concatenate([2.0 * mean - 1.0, obs], -1)
        action = jax.vmap(phase1.bdq.greedy)(weights, seen)
        size = hyper.delta * hyper.shrink**number
        return (
            jax.vmap(lambda m, a, d: step(space, gaussian(space, m), a, d).mean)(
                mean, action, size
            ),
            seen,
            action,
        )

    def at(m):
        return gaussian(space, m)

    mean, policies, rows = np.asarray(first.mean), first.policy, []
    for i in range(iterations + 1):
        keys = jax.vmap(jax.random.split)(batch.at(i))
        policies = arena.train(keys[:, 0], jax.vmap(at)(mean), policies)
        seen = arena.visit(keys[:, 1], batch.where, memory.visiting(policies))
        reward = arena.score(batch.where, memory.deployed(policies))
        memory.add(seen.trials)
        after, obs, action = map(np.asarray, advance(jnp.asarray(mean), jnp.asarray(seen.obs), i))
        rows.append((mean, obs, action, seen.score, reward, policies))
        mean = after
        report(i + 1, iterations + 1, "Phase 2")
    means, seen_by, taken, scores, rewards = (
        np.stack(column, 1) for column in list(zip(*rows, strict=True))[:-1]
    )
    return Tour(means, seen_by, taken, scores, rewards, [row[-1] for row in rows], memory)
