"""BayesOpt: the mean of E chosen by what its policy earned in the target (Muratore et al. 2021;
paper, section 6.2).
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import qmc

from adaptsim_jax.baselines import gp
from adaptsim_jax.baselines.arena import lanes
from adaptsim_jax.baselines.learned import Bout, Trip, first_policies, two_keys
from adaptsim_jax.baselines.memory import Memory
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.space import gaussian


@dataclass(frozen=True)
class BayesOptConfig:
    """initial: points of a Latin hypercube before the first choice; points: in all, 0 for as many
    visits as AdaptSim makes.
    """

    initial: int = 12
    points: int = 0

    def __post_init__(self):
        if self.initial < 2 or self.points < 0:
            raise BadInput(
                f"BayesOpt: initial = {self.initial}, points = {self.points}; give at least 2 and 0"
            )


def bayesopt(bout: Bout) -> Trip:
    """A task policy trained anew at each point, its return of a visit's trials told to a Gaussian
    process.

    The row's iterations are points; a policy is scored as every other method's, over the test
    contexts.
    """
    arena, config = bout.arena, bout.config.bayesopt
    total = config.points or bout.config.starts * (bout.config.iterations + 1)
    batch = lanes(len(arena.targets), bout.seeds, 1, label=7)
    space, D = arena.one.task.space, arena.one.task.space.dim
    rngs = [
        np.random.default_rng([7, int(bout.seeds[s]), int(t)])
        for t, s in zip(batch.where, batch.seed, strict=True)
    ]
    initial = min(config.initial, total)
    points = np.zeros((len(rngs), total, D))
    points[:, :initial] = [qmc.LatinHypercube(D, rng=rng).random(initial) for rng in rngs]
    told, rewards = np.zeros((len(rngs), total)), np.zeros((len(rngs), total))
    memory = Memory(arena, batch, total)
    for i in range(total):
        if i >= initial:
            for b, rng in enumerate(rngs):
                points[b, i] = gp.propose(gp.fit(points[b, :i], told[b, :i], rng), rng)
        train_keys, visit_keys = two_keys(batch.at(i))
        dists = jax.vmap(lambda m: gaussian(space, m))(jnp.asarray(points[:, i], jnp.float32))
        policies = arena.train(
            train_keys, dists, first_policies(bout, batch, arena.untrained(train_keys))
        )
        seen = arena.visit(visit_keys, batch.where, memory.visiting(policies))
        rewards[:, i] = arena.score(batch.where, memory.deployed(policies))
        memory.add(seen.trials)
        told[:, i] = seen.score
        bout.report(i + 1, total)
    spent = arena.one.trials * np.arange(1, total + 1)
    return Trip(batch.grid(rewards), batch.grid(points), spent)
