"""One NAF for a whole box of contexts: it sees the context beside the goal, so that training at a
new context starts near its end.

Actions are tried at many contexts beforehand (`trials` uniform ones each). Batches then pair a
context with a goal and learn from the trial, among some candidates, that serves the goal well and
lies near what the network would do, as `naf_goals` does for one context. The context enters the
first layer only by its bias. A network for one context is therefore the same network without the
context's inputs and with another bias (`fold`, `move`), of the size that a policy trained for that
context alone has.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.learners.naf import NAF, NAFHyper
from adaptsim_jax.learners.naf_goals import GoalProblem
from adaptsim_jax.learners.replay import Transition


@dataclass(frozen=True)
class SharedConfig:
    """Sizes, static under jit. contexts: how many, each with `trials` uniform actions; updates of
    `batch` pairs of context and goal, each with `candidates` trials; temperature, width, rate_end:
    as in `naf_goals.GoalConfig`.
    """

    contexts: int = 2000
    trials: int = 256
    updates: int = 6000
    batch: int = 256
    candidates: int = 32
    temperature: float = 0.03
    width: tuple[float, float] = (0.5, 0.05)
    uniform: float = 0.1
    rate_end: float = 0.02

    def __post_init__(self):
        if min(self.contexts, self.trials, self.updates, self.batch, self.candidates) < 1:
            raise BadInput(f"sizes of the shared policy must be positive, got {self}")
        if self.candidates > self.trials:
            raise BadInput(
                f"{self.candidates} candidates of {self.trials} trials: give at most as many as "
                "there are"
            )


def make_shared_learner(
    naf: NAF,
    problem: GoalProblem,
    context: Callable[[jax.Array], jax.Array],
    shown: Callable[[jax.Array], jax.Array],
    config: SharedConfig,
    hyper: NAFHyper,
) -> Callable[[jax.Array], jax.Array]:
    """`train(key) -> weights [n]` of `naf`, whose observation is `(see(goal), shown(context))`.

    `context(key) -> [c]` draws one; `problem.trial(key, context, action)` tries an action there.
    """

    def train(key):
        made_key, start_key, learn_key = jax.random.split(key, 3)
        data = _tried(made_key, problem, context, config, naf.config.action_dim)

        def one(state, number):
            done = number / config.updates
            batch = _batch(
                jax.random.fold_in(learn_key, number),
                naf,
                problem,
                shown,
                config,
                state.online,
                data,
                done,
            )
            share = jnp.maximum(1.0 - done, config.rate_end)
            return naf.update(
                state, batch, replace(hyper, learning_rate=hyper.learning_rate * share)
            )[0], None

        return jax.lax.scan(one, naf.init(start_key), jnp.arange(config.updates))[0].online

    return train


def fold(weights: jax.Array, obs_dim: int, extra: int, width: int) -> tuple[jax.Array, jax.Array]:
    """A network of `obs_dim + extra` inputs and a first layer of `width` units where the extra
    inputs are 0: weights of the network without them, and what they add to its first bias, `[extra,
    width]`.

    A flat network (`flat`) begins with the bias of its first layer, then that layer's matrix row by
    row.
    """
    bias, kernel, rest = jnp.split(weights, [width, width * (1 + obs_dim + extra)])
    kernel = kernel.reshape(obs_dim + extra, width)
    return jnp.concatenate([bias, kernel[:obs_dim].reshape(-1), rest]), kernel[obs_dim:]


def move(weights: jax.Array, tilt: jax.Array, by: jax.Array) -> jax.Array:
    """Folded weights where the extra inputs `[extra]` change `by` so much."""
    return weights.at[: tilt.shape[1]].add(jnp.sum(by[:, None] * tilt, 0))


def _tried(key, problem: GoalProblem, context, config: SharedConfig, dim: int):
    """Contexts `[C, c]`, actions `[C, N, d]`, outcomes `[C, N, k]`."""
    context_key, action_key, trial_key = jax.random.split(key, 3)
    contexts = jax.vmap(context)(jax.random.split(context_key, config.contexts))
    actions = jax.random.uniform(action_key, (config.contexts, config.trials, dim), minval=-1.0)

    def at(work):
        k, c, some = work
        return jax.vmap(problem.trial, (0, None, 0))(jax.random.split(k, config.trials), c, some)

    return (
        contexts,
        actions,
        jax.lax.map(at, (jax.random.split(trial_key, config.contexts), contexts, actions)),
    )


def _batch(
    key, naf: NAF, problem: GoalProblem, shown, config: SharedConfig, weights, data, done
) -> Transition:
    """`[batch, ...]`: at each pair, one of the candidates in proportion to `exp(reward /
    temperature - away)`.
    """
    contexts, actions, outcomes = data
    keys = jax.random.split(key, 4)
    where = jax.random.randint(keys[0], (config.batch,), 0, config.contexts)
    goals = jax.vmap(problem.draw)(jax.random.split(keys[1], config.batch))
    stride = config.trials // config.candidates
    index = (
        jax.random.randint(keys[2], (config.batch, 1), 0, config.trials)
        + stride * jnp.arange(config.candidates)[None]
    )
    index = index % config.trials
    action, outcome = actions[where[:, None], index], outcomes[where[:, None], index]
    obs = jnp.concatenate([jax.vmap(problem.see)(goals), jax.vmap(shown)(contexts[where])], -1)
    reward = jax.vmap(jax.vmap(problem.reward, (0, None)))(outcome, goals)
    width = config.width[0] + (config.width[1] - config.width[0]) * done
    away = jnp.sum(jnp.square(action - naf.greedy(weights, obs)[:, None]), -1) / (2.0 * width**2)
    level, any_key = jax.random.uniform(keys[3], (2, config.batch))
    odds = jnp.cumsum(jax.nn.softmax(reward / config.temperature - away), -1)
    pick = jnp.minimum(jnp.sum(odds < level[:, None], -1), config.candidates - 1)
    pick = jnp.where(any_key < config.uniform * (1.0 - done), 0, pick)[:, None]
    chosen = jnp.take_along_axis(action, pick[..., None], 1)[:, 0]
    earned = jnp.take_along_axis(reward, pick, 1)[:, 0]
    nothing = jnp.zeros((config.batch, 0), obs.dtype)  # one step: no next observation
    return Transition(obs, chosen, earned, nothing, jnp.zeros_like(earned))
