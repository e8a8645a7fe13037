"""One NAF for a whole box of contexts: it sees the context beside the goal, so that training at a
new context starts near its end.

Actions are tried at many contexts beforehand (`trials` uniform ones each). Batches then pair a
context with a goal. They learn from the trial, among some candidates, that serves the goal well and
lies near what the network would do. So does `naf_goals` for one context. The context enters the
first layer only by its bias. A network for one context is therefore the same network without the
context's inputs and with another bias (`fold`, `move`). It has the size of a policy trained for
that context alone.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
from jax import Array

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.learners.naf import NAF, NAFHyper
from adaptsim_jax.learners.naf_goals import GoalProblem, likely_candidate
from adaptsim_jax.learners.replay import Transition


@dataclass(frozen=True)
class SharedConfig:
    """Sizes, static under jit. contexts: How many, each with `trials` uniform actions; updates of
    `batch` pairs of context and goal, each with `candidates` trials. temperature, width, rate_end:
    As in `naf_goals.GoalConfig`.
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


@dataclass(frozen=True)
class SharedLearner:
    """The training of one network for a whole box of contexts.

    naf: Its observation is `(see(goal), shown(context))`. problem: `problem.trial(key, context,
    action)` tries an action in a context. context: `(key) -> [c]` draws one.
    """

    naf: NAF
    problem: GoalProblem
    context: Callable[[Array], Array]
    shown: Callable[[Array], Array]
    config: SharedConfig
    hyper: NAFHyper

    def train(self, key: Array) -> Array:
        """Weights `[n]` of the network."""
        made_key, start_key, learn_key = jax.random.split(key, 3)
        data = self._data(made_key)

        def one(state, number):
            done = number / self.config.updates
            batch = self._batch(jax.random.fold_in(learn_key, number), state.online, data, done)
            share = jnp.maximum(1.0 - done, self.config.rate_end)
            rates = replace(self.hyper, learning_rate=self.hyper.learning_rate * share)
            return self.naf.update(state, batch, rates)[0], None

        start = self.naf.init(start_key)
        return jax.lax.scan(one, start, jnp.arange(self.config.updates))[0].online

    def _data(self, key):
        """Contexts `[C, c]`, actions `[C, N, d]`, outcomes `[C, N, k]`."""
        config = self.config
        context_key, action_key, trial_key = jax.random.split(key, 3)
        contexts = jax.vmap(self.context)(jax.random.split(context_key, config.contexts))
        shape = (config.contexts, config.trials, self.naf.config.action_dim)
        actions = jax.random.uniform(action_key, shape, minval=-1.0)

        def at(work):
            k, c, some = work
            keys = jax.random.split(k, config.trials)
            return jax.vmap(self.problem.trial, (0, None, 0))(keys, c, some)

        keys = jax.random.split(trial_key, config.contexts)
        return contexts, actions, jax.lax.map(at, (keys, contexts, actions))

    def _batch(self, key, weights, data, done) -> Transition:
        """`[batch, ...]`: at each pair of context and goal, one of the candidates."""
        config, problem = self.config, self.problem
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
        shown = jax.vmap(self.shown)(contexts[where])
        obs = jnp.concatenate([jax.vmap(problem.see)(goals), shown], -1)
        reward = jax.vmap(jax.vmap(problem.reward, (0, None)))(outcome, goals)
        level, any_key = jax.random.uniform(keys[3], (2, config.batch))
        best = self.naf.greedy(weights, obs)
        pick = likely_candidate(config, reward, action, best, done, level)
        pick = jnp.where(any_key < config.uniform * (1.0 - done), 0, pick)[:, None]
        chosen = jnp.take_along_axis(action, pick[..., None], 1)[:, 0]
        earned = jnp.take_along_axis(reward, pick, 1)[:, 0]
        nothing = jnp.zeros((config.batch, 0), obs.dtype)  # one step: no next observation
        return Transition(obs, chosen, earned, nothing, jnp.zeros_like(earned))


def fold(weights: Array, obs_dim: int, extra: int, width: int) -> tuple[Array, Array]:
    """A network of `obs_dim + extra` inputs and a first layer of `width` units where the extra
    inputs are 0: weights of the network without them, and what they add to its first bias, `[extra,
    width]`.

    A flat network (`flat`) begins with the bias of its first layer, then that layer's matrix row by
    row.
    """
    bias, kernel, rest = jnp.split(weights, [width, width * (1 + obs_dim + extra)])
    kernel = kernel.reshape(obs_dim + extra, width)
    return jnp.concatenate([bias, kernel[:obs_dim].reshape(-1), rest]), kernel[obs_dim:]


def move(weights: Array, tilt: Array, by: Array) -> Array:
    """Folded weights where the extra inputs `[extra]` change `by` so much."""
    return weights.at[: tilt.shape[1]].add(jnp.sum(by[:, None] * tilt, 0))
