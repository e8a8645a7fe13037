"""What a NAF learner gives the baselines of a task with one decision a trial, whatever is pushed or
scooped.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core import config as configs
from adaptsim_jax.core.errors import BadInput
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
    observed: Callable[[jax.Array], jax.Array],
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
        act=lambda old, contexts: naf.greedy(old.weights, observed(contexts)),
        explore=lambda key, old, contexts: naf.act(
            key, old.weights, observed(contexts), training.noise
        ),
        train_uniform=train_uniform,
        tune=tune,
    )


def read_saved(
    path: str | Path, kind: type, policy: type, make_naf: Callable, make_policy: Callable, what: str
):
    """`act(seen [2] or [N, 2]) -> actions` of a `best.toml` or `policy.toml`.

    kind: of the task's configuration, which has `hidden`; policy: of its policies, made of weights.
    Make_naf(config) and make_policy(config): the task's own; what: the task in a message. Raises
    BadInput where the file holds no policy of this task.
    """
    table = configs.read(path)
    given, hidden = table.get("policy"), table.get("hidden")
    weights = given.get("weights") if isinstance(given, dict) else None
    if isinstance(hidden, list) and all(isinstance(n, int) and 0 < n <= 4096 for n in hidden):
        sizes = hidden
    else:
        sizes = None
    config = None if sizes is None else kind(hidden=tuple(sizes))
    if (
        config is None
        or not isinstance(weights, list)
        or np.shape(weights) != (_count(make_naf(config)),)
    ):
        raise BadInput(
            f"{path}: holds no policy of {what}; write it again with 'adaptsim robot next'"
        )
    act, learned = jax.jit(make_policy(config)), policy(jnp.asarray(weights, jnp.float32))
    return lambda observed: np.asarray(act(learned, jnp.asarray(observed, jnp.float32)))


def _count(naf: Any) -> int:
    """How many weights the networks of `naf` have."""
    return jax.eval_shape(lambda: naf.init(jax.random.key(0)).online).size


def leaves_by_name(policy: Any) -> dict[str, Any]:
    """The leaves of a task policy as nested lists, by name."""
    import jax
    import numpy as np

    leaves = jax.tree_util.tree_flatten_with_path(policy)[0]
    return {
        jax.tree_util.keystr(path).strip(".[]'"): np.asarray(leaf).tolist() for path, leaf in leaves
    }
