"""Tasks with one decision a trial: a policy sees a context (a goal, where a piece lies) and chooses
an action. The trial is open loop.

What the baselines need of such a task beyond `Task`, so that they know nothing of what is pushed or
scooped. Targets are *worlds*: the task's own simulator, or any other engine. They run trials one by
one, outside of compiled code. `naf_policies` has what a NAF learner gives such a task.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core import config as configs
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.learners.naf import NAF
from adaptsim_jax.learners.naf_goals import GoalConfig, GoalLearner, Trials
from adaptsim_jax.tasks.base import Task

Array = Any
Outcome = Any  # a pytree


class TargetWorld(NamedTuple):
    """Where policies are tried. `run(params [B, D], contexts [B, g], actions [B, d]) -> (outcomes
    [B, ...], codes [B])`.

    Actions span [-1, 1]. `codes` are 0, or why a trial failed, as `messages` say; its outcome is
    not-a-number, and its reward 0.
    """

    name: str
    run: Callable
    messages: dict[int, str]


@dataclass(frozen=True)
class OneShot:
    """A `Task` of one decision a trial, as pure functions of one sample (`[...]` where any leading
    axes may stand).

    tests: `[G, g]` contexts that a policy is scored on, the same for all. trials: A visit of the
        adaptation.
    fresh: `[F, g]` more of them, by which nothing is chosen: the best of many policies by `tests`
        is partly the luckiest.
    """

    task: Task
    tests: np.ndarray
    trials: int
    action_dim: int
    draw: Callable  # (key) -> context [g]
    act: Callable  # (policy, contexts [N, g]) -> [N, d] in [-1, 1]
    explore: Callable  # (key, policy, contexts [N, g]) -> [N, d], with the learner's noise
    reward: Callable  # (outcome, context [g]) -> [] in [0, 1]; 0 for what is not finite
    trajectory: Callable  # (contexts [N, g], outcomes [N, ...]) -> the task's trajectory
    train_uniform: Callable  # (key) -> one policy for all of Omega (UDR)
    # (key, policy, contexts [N, g], actions [N, d], outcomes [N, ...], used []) -> policy, from the
    # first `used` trials
    tune: Callable
    outputs: Callable  # outcome -> [k]: what of it is predicted
    worth: Callable  # (predicted [k], context) -> []: the reward of it
    world: Callable  # (backend) -> World; BadInput for one that is not there
    oracle: Callable  # (world, params [D]) -> [G] rewards of the best actions
    engine: str  # the world that is the simulator
    simulator: str  # in words, as results.json says it
    reward_unit: str
    oracle_means: str
    aim: Callable | None = (
        None  # (key, policy) -> contexts [trials, g] of a visit; None: each drawn
    )
    # (trajectory, policy) -> trajectory with what else is observed that the policy tells, such as
    # what E expects; None: nothing
    expect: Callable | None = None
    # (policy, actions [K, d] and outcomes [K, ...] of the target's trials, which of them count [K])
    # -> policy to deploy, mended by them; None: it is not
    remember: Callable | None = None
    # (policy, mended by `remember` once there are trials) -> policy as `act` makes a visit with it,
    # part of its trials to learn more for what is deployed; None: a visit's trials are the policy's
    # own, not mended
    probe: Callable | None = None
    fresh: np.ndarray | None = None
    # (context, action) -> [p]: what an outcome depends on
    inputs: Callable = lambda context, action: action

    @property
    def scored(self) -> np.ndarray:
        """`[G + F, g]`: `tests`, then `fresh`."""
        if self.fresh is None:
            return self.tests
        return np.concatenate([self.tests, self.fresh])


def action_grid(points: tuple[int, ...]) -> np.ndarray:
    """`[A, d]`: a regular grid over `[-1, 1]^d`, `points[i]` a side."""
    return np.array(list(product(*(np.linspace(-1.0, 1.0, n) for n in points))), np.float32)


def best_actions(
    world: TargetWorld,
    params: np.ndarray,
    contexts: np.ndarray,
    reward: Callable[[Outcome, Array], Array],
    points: tuple[int, ...],
    *,
    shared: bool = False,
    rounds: int = 0,
) -> tuple[np.ndarray, np.ndarray]:
    """`(rewards [G], actions [G, d])` of the best of a grid of actions for each of `contexts [G,
    g]` in `params [D]`.

    `shared`: outcomes do not depend on the context, so that one grid serves all. Each of `rounds`
    then tries the neighbours of each context's best action at half the spacing before.
    """
    G, d = len(contexts), len(points)
    grid = action_grid(points)
    valued = jax.jit(jax.vmap(reward))
    if shared:
        pairs = np.tile(contexts[:1], (len(grid), 1))
        outcomes, _ = world.run(np.tile(params, (len(grid), 1)), pairs, grid)
        valued_in_each = jax.jit(jax.vmap(jax.vmap(reward, (0, None)), (None, 0)))
        every = np.asarray(valued_in_each(outcomes, jnp.asarray(contexts)))
    else:
        pairs = np.repeat(contexts, len(grid), 0)
        outcomes, _ = world.run(np.tile(params, (len(pairs), 1)), pairs, np.tile(grid, (G, 1)))
        every = np.asarray(valued(outcomes, jnp.asarray(pairs))).reshape(G, -1)
    best, rewards = grid[every.argmax(1)], every.max(1)
    spacing = 2.0 / (np.array(points) - 1)
    around = action_grid((3,) * d)
    around = around[np.abs(around).sum(1) > 0]
    for k in range(rounds):
        moves = around[None] * spacing / 2 ** (k + 1)
        tried = np.clip(best[:, None] + moves, -1.0, 1.0).astype(np.float32)
        pairs, flat = np.repeat(contexts, len(around), 0), tried.reshape(-1, d)
        outcomes, _ = world.run(np.tile(params, (len(flat), 1)), pairs, flat)
        found = np.asarray(valued(outcomes, jnp.asarray(pairs))).reshape(G, -1)
        better = found.max(1) > rewards
        best = np.where(better[:, None], tried[np.arange(G), found.argmax(1)], best)
        rewards = np.maximum(rewards, found.max(1))
    return rewards, best


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
) -> dict[str, Callable]:
    """The fields `act`, `explore`, `train_uniform` and `tune` of `OneShot`.

    learner: Trained over all of Omega. budget: Trials of one policy; `policy(weights [n])`: the
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

    kind: Of the task's configuration, which has `hidden`. policy: Of its policies, made of weights.
    Make_naf(config) and make_policy(config): the task's own. what: The task in a message. Raises
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


def leaves_by_name(policy: Any) -> Table:
    """The leaves of a task policy as nested lists, by name."""
    leaves = jax.tree_util.tree_flatten_with_path(policy)[0]
    return {
        jax.tree_util.keystr(path).strip(".[]'"): np.asarray(leaf).tolist() for path, leaf in leaves
    }
