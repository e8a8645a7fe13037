"""NAF on goals reached with a single open-loop action: a contextual bandit whose goals can be
relabelled.

What an action leads to does not depend on the goal that it was chosen for. A stored trial therefore
serves every goal: its reward is computed anew for goals drawn when a batch is drawn (hindsight
relabelling, Andrychowicz et al. 2017, here without bias, since nothing of the trial depended on the
goal). `relabel=0` learns from the goals as they were aimed at.

Everything is for one policy with its own replay; vmap over policies. Round numbers stay unbatched
(see `replay`).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.learners import replay as ring
from adaptsim_jax.learners.naf import NAF, NAFHyper, NAFState
from adaptsim_jax.learners.replay import Transition

_CHECKS = 2**31 - 1  # the number that checks' keys are drawn with; no round has it


class GoalProblem(NamedTuple):
    """Pure functions of one sample. `context` is whatever trials depend on, such as a distribution
    of parameters.

    draw: key -> goal `[g]`; see: goal -> observation `[obs_dim]`; trial: (key, context, action
        `[d]`) -> outcome `[k]`;
    reward: (outcome, goal) -> `[]`. worth: (key, context, act) -> `[]`, how good a policy
        `act(goal) -> action` is; where it is given, a training ends with the best of its rounds'
        policies, the first included, and not with the last.
    """

    draw: Callable[[jax.Array], jax.Array]
    see: Callable[[jax.Array], jax.Array]
    trial: Callable[[jax.Array, Any, jax.Array], jax.Array]
    reward: Callable[[jax.Array, jax.Array], jax.Array]
    worth: Callable[[jax.Array, Any, Callable], jax.Array] | None = None


@dataclass(frozen=True)
class GoalConfig:
    """Sizes and shares, static under jit. A *round* makes `block` trials and then `updates`
    gradient steps.

    relabel: share of a batch whose goals are drawn anew. near: share of those whose trial is not
    any stored one, but one of `candidates`, likely in proportion to `exp(reward / temperature - |a
    - best|^2 / 2 width^2)`: Q is a quadratic, which fits a real reward only near the best action,
    and there the data must be. Over a training the share rises to 1 and the width goes from its
    first value to its second (actions span [-1, 1]).
    uniform: share of trials with uniform actions, the others follow the policy with noise of
    covariance `noise * inverse(P)`. The learning rate falls linearly to `rate_end` of its start
    over a training.
    """

    block: int = 100
    updates: int = 10
    batch: int = 64
    capacity: int = 10_000
    relabel: float = 1.0
    near: float = 0.9
    candidates: int = 32
    temperature: float = 0.1
    width: tuple[float, float] = (0.5, 0.1)
    uniform: float = 0.5
    noise: float = 0.1
    rate_end: float = 0.05


class Trials(NamedTuple):
    """Stored trials: goal `[..., g]` aimed at, action `[..., d]`, outcome `[..., k]`."""

    goal: jax.Array
    action: jax.Array
    outcome: jax.Array


class GoalState(NamedTuple):
    """What the next round needs, apart from its number."""

    learner: NAFState
    replay: Trials


class GoalLearner(NamedTuple):
    """See `make_goal_learner`."""

    train: Callable[..., jax.Array]
    tune: Callable[..., jax.Array]


def make_goal_learner(
    naf: NAF, problem: GoalProblem, config: GoalConfig, hyper: NAFHyper = NAFHyper()
) -> GoalLearner:
    """Check the sizes and return the training of one policy as pure functions.

    * `train(keys [P], weights [P, n], contexts [P, ...], rounds [P], longest []) -> weights [P,
      n]`: `P` policies together, each for its own number of rounds, with a new replay and
      optimiser. `longest`, the largest of them, may be traced: it sets the time taken.
    * `tune(key, weights [n], trials [N], used [], updates) -> weights [n]`: one policy from the
      first `used` of given trials, made anywhere. None where there are none
    """
    _check(config)
    shapes = jax.eval_shape(problem.draw, jax.random.key(0))
    action: Any = jax.ShapeDtypeStruct((naf.config.action_dim,), shapes.dtype)

    def start(weights, context):
        outcome = jax.eval_shape(problem.trial, jax.random.key(0), context, jnp.zeros(action.shape))
        return GoalState(
            naf.fresh(weights), ring.empty(Trials(shapes, action, outcome), config.capacity)
        )

    def step(key, state, context, number, rounds):
        """Round `number []` of `rounds []`; past the last one, weights stay as they are."""
        trial_key, learn_key = jax.random.split(key)
        block = _collect(trial_key, naf, problem, config, state.learner.online, context)
        stored = ring.write(state.replay, block, number)
        filled = jnp.minimum((number + 1) * config.block, config.capacity)
        done = jnp.clip(number / jnp.maximum(rounds, 1), 0.0, 1.0)
        batches = _batches(
            learn_key, naf, problem, config, state.learner.online, stored, filled, done
        )
        share = jnp.maximum(1.0 - number / jnp.maximum(rounds, 1), config.rate_end) * (
            number < rounds
        )
        return GoalState(learned(state.learner, batches, share), stored)

    def learned(learner, batches, share):
        """The learner after updates on `batches`, at a share of its rate."""
        rates = replace(hyper, learning_rate=hyper.learning_rate * share)
        return jax.lax.scan(lambda s, b: (naf.update(s, b, rates)[0], None), learner, batches)[0]

    def train(keys, weights, contexts, rounds, longest):
        def at(number):
            return jax.vmap(jax.random.fold_in, (0, None))(keys, number)

        def one(number, state):
            return jax.vmap(step, (0, 0, 0, None, 0))(at(number), state, contexts, number, rounds)

        begin = jax.vmap(start)(weights, contexts)
        worth = problem.worth
        if worth is None:
            return jax.lax.fori_loop(0, longest, one, begin).learner.online

        def valued(keys, weights):
            def act(w):
                return lambda goal: naf.greedy(w, problem.see(goal))

            return jax.vmap(lambda k, c, w: worth(k, c, act(w)))(keys, contexts, weights)

        def checked(number, carry):
            state = one(number, carry[0])
            value = valued(at(_CHECKS), state.learner.online)  # the same checks in all rounds
            better = (value > carry[2]) & (number < rounds)
            selected = jnp.where(better[:, None], state.learner.online, carry[1])
            return state, selected, jnp.where(better, value, carry[2])

        return jax.lax.fori_loop(
            0, longest, checked, (begin, weights, valued(at(_CHECKS), weights))
        )[1]

    def tune(key, weights, trials, used, updates):
        given = replace(config, updates=updates)
        sized = jnp.maximum(used, 1)
        batches = _batches(key, naf, problem, given, weights, trials, sized, jnp.ones(()))
        return learned(naf.fresh(weights), batches, used > 0).online

    return GoalLearner(train, tune)


def _collect(key, naf: NAF, problem: GoalProblem, config: GoalConfig, weights, context) -> Trials:
    """`[block]` trials: the first share uniform over the actions, the rest as the policy chooses,
    with noise.
    """
    goal_key, act_key, uniform_key, trial_key = jax.random.split(key, 4)
    goals = jax.vmap(problem.draw)(jax.random.split(goal_key, config.block))
    actions = naf.act(act_key, weights, jax.vmap(problem.see)(goals), config.noise)
    uniform = jax.random.uniform(uniform_key, actions.shape, actions.dtype, -1.0, 1.0)
    first = jnp.arange(config.block) < round(config.uniform * config.block)
    actions = jnp.where(first[:, None], uniform, actions)

    def trial(k, a):
        return problem.trial(k, context, a)

    return Trials(
        goals, actions, jax.vmap(trial)(jax.random.split(trial_key, config.block), actions)
    )


def _batches(
    key, naf: NAF, problem: GoalProblem, config: GoalConfig, weights, stored: Trials, filled, done
) -> Transition:
    """`[updates, batch, ...]`: trials, and the goals that they are learned from; `done`: how far
    the training is, 0 to 1.
    """
    shape = (config.updates, config.batch)
    goal_key, key = jax.random.split(key)
    first, relabelled, chosen, level = jnp.moveaxis(jax.random.uniform(key, (*shape, 4)), -1, 0)
    first = jnp.minimum((first * filled).astype(jnp.int32), filled - 1)

    def fetch(index):
        return jax.tree.map(lambda x: jnp.take(x, index, axis=0), stored)

    if config.relabel == 0:
        trials = fetch(first)
        goals = trials.goal
    else:
        redrawn = relabelled < config.relabel
        goals = jax.vmap(problem.draw)(jax.random.split(goal_key, shape[0] * shape[1])).reshape(
            *shape, -1
        )
        goals = jnp.where(redrawn[..., None], goals, jnp.take(stored.goal, first, axis=0))
        # candidates lie a stride apart, so that they are of all ages: one random number finds all
        # of them
        stride = jnp.maximum(filled // config.candidates, 1)
        index = (first[..., None] + stride * jnp.arange(config.candidates)[None, None]) % filled
        likely = _likely(naf, problem, config, weights, stored, index, goals, done, level)
        near = 1.0 - (1.0 - config.near) * (1.0 - done)
        trials = fetch(jnp.where(redrawn & (chosen < near), likely, first))
    reward = _over(problem.reward, 2)(trials.outcome, goals)
    obs = _over(problem.see, 2)(goals)
    nothing = jnp.zeros((*shape, 0), obs.dtype)  # one step: no next observation
    return Transition(obs, trials.action, reward, nothing, jnp.zeros_like(reward))


def _likely(naf, problem, config, weights, stored: Trials, index, goals, done, level) -> jax.Array:
    """One of the candidates `index [..., m]` for each goal: good for it, and near what the policy
    would do now.

    `level [...]` is uniform in [0, 1]; it picks by the cumulated probability.
    """
    width = config.width[0] + (config.width[1] - config.width[0]) * done
    outcome, action = (jnp.take(x, index, axis=0) for x in (stored.outcome, stored.action))
    reward = _over(jax.vmap(problem.reward, (0, None)), 2)(outcome, goals)
    best = naf.greedy(weights, _over(problem.see, 2)(goals))
    away = jnp.sum(jnp.square(action - best[..., None, :]), -1) / (2.0 * width**2)
    odds = jnp.cumsum(jax.nn.softmax(reward / config.temperature - away), -1)
    pick = jnp.sum(odds < level[..., None], -1, keepdims=True)
    return jnp.take_along_axis(index, jnp.minimum(pick, config.candidates - 1), -1)[..., 0]


def _over(function, levels: int):
    """`function` of one sample, over `levels` leading axes."""
    for _ in range(levels):
        function = jax.vmap(function)
    return function


def _check(config: GoalConfig) -> None:
    if min(config.block, config.updates, config.batch) < 1:
        raise BadInput(f"training sizes must be positive, got {config}")
    if config.candidates < 1 or config.temperature <= 0:
        raise BadInput(f"candidates must be at least 1 and temperature positive, got {config}")
    for name in ("relabel", "near", "uniform"):
        if not 0.0 <= getattr(config, name) <= 1.0:
            raise BadInput(f"{name} = {getattr(config, name)} is a share; give 0 to 1")
    ring.check_capacity(config.capacity, config.block)
