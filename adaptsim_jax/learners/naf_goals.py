"""NAF on goals reached with a single open-loop action: a contextual bandit whose goals can be
relabelled.

What an action leads to does not depend on the goal that it was chosen for. A stored trial therefore
serves every goal. Its reward is computed anew for goals drawn when a batch is drawn. This is
hindsight relabelling (Andrychowicz et al. 2017), here without bias, since nothing of the trial
depended on the goal. `relabel=0` learns from the goals as they were aimed at.

Everything is for one policy with its own replay; vmap over policies. Round numbers stay unbatched
(see `replay`).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.learners import replay as ring
from adaptsim_jax.learners.naf import NAF, NAFHyper, NAFState
from adaptsim_jax.learners.replay import Transition

_CHECKS = 2**31 - 1  # the number that checks' keys are drawn with; no round has it


class GoalProblem(NamedTuple):
    """Pure functions of one sample. `context` is whatever trials depend on, such as a distribution
    of parameters.

    draw: Key -> goal `[g]`. see: Goal -> observation `[obs_dim]`; trial: (key, context, action
        `[d]`) -> outcome `[k]`;
    reward: (outcome, goal) -> `[]`. worth: (key, context, act) -> `[]`, how good a policy
        `act(goal) -> action` is; where it is given, a training ends with the best of its rounds'
        policies, the first included, and not with the last.
    """

    draw: Callable[[Array], Array]
    see: Callable[[Array], Array]
    trial: Callable[[Array, Any, Array], Array]
    reward: Callable[[Array, Array], Array]
    worth: Callable[[Array, Any, Callable], Array] | None = None


@dataclass(frozen=True)
class GoalConfig:
    """Sizes and shares, static under jit. A *round* makes `block` trials and then `updates`
    gradient steps.

    relabel: Share of a batch whose goals are drawn anew. near: Share of those whose trial is not
    any stored one, but one of `candidates`, likely in proportion to `exp(reward / temperature - |a
    - best|^2 / 2 width^2)`: Q is a quadratic, which fits a real reward only near the best action,
    and there the data must be. Over a training the share rises to 1 and the width goes from its
    first value to its second (actions span [-1, 1]).
    uniform: Share of trials with uniform actions, the others follow the policy with noise of
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

    goal: Array
    action: Array
    outcome: Array


class GoalState(NamedTuple):
    """What the next round needs, apart from its number."""

    learner: NAFState
    replay: Trials


@dataclass(frozen=True)
class GoalLearner:
    """The training of policies as pure functions: `train` of several together, `tune` of one."""

    naf: NAF
    problem: GoalProblem
    config: GoalConfig
    hyper: NAFHyper

    def train(self, keys, weights, contexts, rounds, longest) -> Array:
        """`P` policies together, each for its own number of rounds, from an empty replay.

        Args:
            keys: `[P]`. weights: `[P, n]`. contexts: `[P, ...]`. rounds: `[P]`.
            longest: `[]`, the largest of `rounds`. It may be traced, and sets the time taken.

        Returns:
            Weights `[P, n]`.
        """

        def at(number):
            return jax.vmap(jax.random.fold_in, (0, None))(keys, number)

        def one(number, state):
            over = jax.vmap(self._round, (0, 0, 0, None, 0))
            return over(at(number), state, contexts, number, rounds)

        begin = jax.vmap(self._start)(weights, contexts)
        if self.problem.worth is None:
            return jax.lax.fori_loop(0, longest, one, begin).learner.online
        checks = at(_CHECKS)  # the same checks in all rounds

        def checked(number, carry):
            state = one(number, carry[0])
            value = self._valued(checks, contexts, state.learner.online)
            better = (value > carry[2]) & (number < rounds)
            selected = jnp.where(better[:, None], state.learner.online, carry[1])
            return state, selected, jnp.where(better, value, carry[2])

        first = (begin, weights, self._valued(checks, contexts, weights))
        return jax.lax.fori_loop(0, longest, checked, first)[1]

    def tune(self, key, weights, trials: Trials, used, updates: int) -> Array:
        """One policy from the first `used []` of given trials `[N]`, made anywhere.

        Returns:
            Weights `[n]`, as they were where there are no trials.
        """
        given = replace(self, config=replace(self.config, updates=updates))
        batches = given.batches(key, weights, trials, jnp.maximum(used, 1), jnp.ones(()))
        return self._learned(self.naf.fresh(weights), batches, used > 0).online

    def _start(self, weights, context) -> GoalState:
        goal = jax.eval_shape(self.problem.draw, jax.random.key(0))
        action: Any = jax.ShapeDtypeStruct((self.naf.config.action_dim,), goal.dtype)
        blank = jnp.zeros(action.shape)
        outcome = jax.eval_shape(self.problem.trial, jax.random.key(0), context, blank)
        stored = ring.empty(Trials(goal, action, outcome), self.config.capacity)
        return GoalState(self.naf.fresh(weights), stored)

    def _round(self, key, state: GoalState, context, number, rounds) -> GoalState:
        """Round `number []` of `rounds []`; past the last one, weights stay as they are."""
        config, weights = self.config, state.learner.online
        trial_key, learn_key = jax.random.split(key)
        block = self._collect(trial_key, weights, context)
        stored = ring.write(state.replay, block, number)
        filled = jnp.minimum((number + 1) * config.block, config.capacity)
        done = jnp.clip(number / jnp.maximum(rounds, 1), 0.0, 1.0)
        batches = self.batches(learn_key, weights, stored, filled, done)
        share = jnp.maximum(1.0 - number / jnp.maximum(rounds, 1), config.rate_end) * (
            number < rounds
        )
        return GoalState(self._learned(state.learner, batches, share), stored)

    def _learned(self, learner: NAFState, batches: Transition, share) -> NAFState:
        """The learner after updates on `batches`, at a share of its rate."""
        rates = replace(self.hyper, learning_rate=self.hyper.learning_rate * share)

        def update(state, batch):
            return self.naf.update(state, batch, rates)[0], None

        return jax.lax.scan(update, learner, batches)[0]

    def _valued(self, keys, contexts, weights) -> Array:
        """How good policies are, `[P]`."""
        worth = self.problem.worth
        assert worth is not None

        def one(key, context, w):
            return worth(key, context, lambda goal: self.naf.greedy(w, self.problem.see(goal)))

        return jax.vmap(one)(keys, contexts, weights)

    def _collect(self, key, weights, context) -> Trials:
        """`[block]` trials: the first share uniform over the actions, the rest as the policy
        chooses, with noise.
        """
        config, problem = self.config, self.problem
        goal_key, act_key, uniform_key, trial_key = jax.random.split(key, 4)
        goals = jax.vmap(problem.draw)(jax.random.split(goal_key, config.block))
        actions = self.naf.act(act_key, weights, jax.vmap(problem.see)(goals), config.noise)
        uniform = jax.random.uniform(uniform_key, actions.shape, actions.dtype, -1.0, 1.0)
        first = jnp.arange(config.block) < round(config.uniform * config.block)
        actions = jnp.where(first[:, None], uniform, actions)
        keys = jax.random.split(trial_key, config.block)
        outcomes = jax.vmap(problem.trial, (0, None, 0))(keys, context, actions)
        return Trials(goals, actions, outcomes)

    def batches(self, key, weights, stored: Trials, filled, done) -> Transition:
        """`[updates, batch, ...]`: trials, and the goals that they are learned from.

        Args:
            stored: Trials, of which the first `filled []` are there.
            done: `[]`, how far the training is, 0 to 1.
        """
        config, problem = self.config, self.problem
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
            # candidates lie a stride apart, so that they are of all ages: one random number finds
            # all of them
            stride = jnp.maximum(filled // config.candidates, 1)
            index = (first[..., None] + stride * jnp.arange(config.candidates)[None, None]) % filled
            likely = self._likely(weights, fetch(index), goals, done, level)
            likely = jnp.take_along_axis(index, likely[..., None], -1)[..., 0]
            near = 1.0 - (1.0 - config.near) * (1.0 - done)
            trials = fetch(jnp.where(redrawn & (chosen < near), likely, first))
        reward = _over(problem.reward, 2)(trials.outcome, goals)
        obs = _over(problem.see, 2)(goals)
        nothing = jnp.zeros((*shape, 0), obs.dtype)  # one step: no next observation
        return Transition(obs, trials.action, reward, nothing, jnp.zeros_like(reward))

    def _likely(self, weights, candidates: Trials, goals, done, level) -> Array:
        """Which of `candidates [..., m]` each goal takes: good for it, and near what the policy
        would do now.
        """
        reward = _over(jax.vmap(self.problem.reward, (0, None)), 2)(candidates.outcome, goals)
        best = self.naf.greedy(weights, _over(self.problem.see, 2)(goals))
        return likely_candidate(self.config, reward, candidates.action, best, done, level)


def likely_candidate(config: Any, reward, action, best, done, level) -> Array:
    """Which candidate is taken: in proportion to `exp(reward / temperature - |a - best|^2 / 2
    width^2)`.

    Args:
        config: Holds `temperature` and `width`, the second at the start and the end of a training.
        reward: `[..., m]`. action: `[..., m, d]`. best: `[..., d]`, what the policy would do.
        done: `[]`, how far the training is, 0 to 1.
        level: `[...]`, uniform in [0, 1]; it picks by the cumulated probability.

    Returns:
        `[...]`, of the m candidates.
    """
    width = config.width[0] + (config.width[1] - config.width[0]) * done
    away = jnp.sum(jnp.square(action - best[..., None, :]), -1) / (2.0 * width**2)
    odds = jnp.cumsum(jax.nn.softmax(reward / config.temperature - away), -1)
    pick = jnp.sum(odds < level[..., None], -1)
    return jnp.minimum(pick, reward.shape[-1] - 1)


def make_goal_learner(
    naf: NAF, problem: GoalProblem, config: GoalConfig, hyper: NAFHyper = NAFHyper()
) -> GoalLearner:
    """The training of a policy; BadInput where the sizes do not fit."""
    _check(config)
    return GoalLearner(naf, problem, config, hyper)


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
