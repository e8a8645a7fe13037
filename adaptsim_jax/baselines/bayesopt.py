"""BayesOpt: the mean of E chosen by what its policy earned in the target (Muratore et al. 2021;
paper, section 6.2).
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import qmc

from adaptsim_jax.baselines import gp
from adaptsim_jax.baselines.adapting import first_policies
from adaptsim_jax.baselines.arena import MethodRun, Visits
from adaptsim_jax.baselines.lanes import Memory, lanes, two_keys
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


def bayesopt(run: MethodRun) -> Visits:
    """A task policy trained anew at each point, its return of a visit's trials returns to a Gaussian
    process.

    The row's iterations are points; a policy is scored as every other method's, over the test
    contexts.
    """
    arena, config = run.arena, run.config.bayesopt
    total = config.points or run.config.starts * (run.config.iterations + 1)
    batch = lanes(len(arena.targets), run.seeds, 1, label=7)
    space, D = arena.one.task.space, arena.one.task.space.dim
    rngs = [
        np.random.default_rng([7, int(run.seeds[s]), int(t)])
        for t, s in zip(batch.where, batch.seed, strict=True)
    ]
    initial = min(config.initial, total)
    points = np.zeros((len(rngs), total, D))
    points[:, :initial] = [qmc.LatinHypercube(D, rng=rng).random(initial) for rng in rngs]
    returns, rewards = np.zeros((len(rngs), total)), np.zeros((len(rngs), total))
    memory = Memory(arena, batch, total)
    for i in range(total):
        if i >= initial:
            for b, rng in enumerate(rngs):
                points[b, i] = gp.propose(gp.fit(points[b, :i], returns[b, :i], rng), rng)
        train_keys, visit_keys = two_keys(batch.at(i))
        dists = jax.vmap(lambda m: gaussian(space, m))(jnp.asarray(points[:, i], jnp.float32))
        policies = arena.train(
            train_keys, dists, first_policies(run, batch, arena.untrained(train_keys))
        )
        observed = arena.visit(visit_keys, batch.where, memory.visiting(policies))
        rewards[:, i] = arena.score(batch.where, memory.deployed(policies))
        memory.add(observed.trials)
        returns[:, i] = observed.score
        run.report(i + 1, total)
    spent = arena.one.trials * np.arange(1, total + 1)
    return Visits(batch.grid(points), spent, batch.grid(rewards))
