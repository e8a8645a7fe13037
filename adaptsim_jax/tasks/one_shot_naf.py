"""What a NAF learner gives the baselines of a task with one decision a trial, whatever is pushed or
scooped.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from adaptsim_jax.learners.naf import NAF
from adaptsim_jax.learners.naf_goals import GoalConfig, GoalLearner, Trials

# UDR has to serve all of Omega: as many times the trials of one policy (M_max of the paper by M)
UDR_BUDGETS = 3
TUNE_UPDATES = 200  # gradient steps on a target's trials, after each lot of them


def naf_policies(
    naf: NAF,
    learner: GoalLearner,
    budget: int,
    training: GoalConfig,
    policy: Callable[[jax.Array], Any],
    seen: Callable[[jax.Array], jax.Array],
    trials: Callable[[Any, jax.Array, Any], Trials],
) -> dict[str, Callable[..., Any]]:
    """The fields `act`, `explore`, `train_uniform` and `tune` of `OneShot`.

    learner: trained over all of Omega; budget: trials of one policy; `policy(weights [n])`: the
    task's; `seen(contexts)`: what it sees of them; `trials(contexts, actions, outcomes)`: what it
    learns from.
    """
    rounds = -(-UDR_BUDGETS * budget // training.block)

    def train_uniform(key):
        init_key, train_key = jax.random.split(key)
        weights = naf.init(init_key).online[None]
        return policy(
            learner.train(train_key[None], weights, jnp.zeros(1), jnp.full(1, rounds), rounds)[0]
        )

    def tune(key, old, contexts, actions, outcomes, used):
        return policy(
            learner.tune(key, old.weights, trials(contexts, actions, outcomes), used, TUNE_UPDATES)
        )

    return dict(
        act=lambda old, contexts: naf.greedy(old.weights, seen(contexts)),
        explore=lambda key, old, contexts: naf.act(
            key, old.weights, seen(contexts), training.noise
        ),
        train_uniform=train_uniform,
        tune=tune,
    )
