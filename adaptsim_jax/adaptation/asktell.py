"""Phase 2 with whatever a target is: ask which policy to run, tell what was measured (paper,
Algorithm 2).

The state is a pytree of arrays, so that it can be kept on disk between trials. Told simulated
trajectories, this visits the same distributions as `phase2.adapt`.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from adaptsim_jax import space as spaces
from adaptsim_jax.adaptation.phase1 import DistributionArchive, archive_size
from adaptsim_jax.adaptation.phase2 import best_visit, draw_starts, smoothed
from adaptsim_jax.adaptation.training import Trained, load_run
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.store import RunFolder
from adaptsim_jax.learners.bdq import BDQ
from adaptsim_jax.space import gaussian
from adaptsim_jax.tasks.base import Task


class Tried(NamedTuple):
    """All trials of a session: mean `[T, D]` unit coordinates, policy `[T, ...]`, raw return score
    `[T]`, NaN of those to come.
    """

    mean: Array
    policy: Any
    score: Array


class AskState(NamedTuple):
    """What the next call needs.

    told: `[]` int32, trials so far; mean: `[D]` unit coordinates and policy: What to run now;
    starts: `[N, ...]`; best_*: of the trial with the highest raw return so far, or where the task
        has its doubts of single returns of that with the highest expected one (`phase2.smoothed`).
        tried: What that is chosen from, else empty.
    """

    key: Array
    told: Array
    mean: Array
    policy: Any
    starts: DistributionArchive
    best_score: Array
    best_mean: Array
    best_policy: Any
    tried: Tried | tuple[()] = ()


class TrialInfo(NamedTuple):
    """What came of a trial: raw return `score: []`, greedy `action: [D]`, `best: []` if the best so
    far.
    """

    score: Array
    action: Array
    best: Array


class AskTell:
    """Greedy adaptation of each start for `iterations` steps: `N (iterations + 1)` trials in all.

    Pure functions of an `AskState`, but for its number of trials, which is read in Python.
    """

    def __init__(
        self,
        task: Task,
        bdq: BDQ,
        weights: Any,
        *,
        iterations: int = 10,
        delta: float = 0.1,
        shrink: float = 1.0,
    ):
        if iterations < 1:
            raise BadInput(f"iterations = {iterations}: nothing would be adapted; use at least 1")
        self.task, self.bdq, self.weights = task, bdq, weights
        self.iterations, self.delta, self.shrink = iterations, delta, shrink
        self._train = jax.jit(
            lambda key, mean, policy: task.train(key, gaussian(task.space, mean), policy)
        )

    def init(self, key: Array, starts: DistributionArchive) -> AskState:
        """Before any trial, from `starts [N, ...]`."""
        mean, policy = jax.tree.map(lambda x: x[0], starts)
        policy = self._train(jax.random.fold_in(key, 0), mean, policy)
        count = starts.mean.shape[0] * (self.iterations + 1)

        def room(x):
            return jnp.zeros((count, *jnp.shape(x)), jnp.result_type(x))

        tried: Tried | tuple[()] = ()
        if self.task.doubt:
            tried = Tried(room(mean), jax.tree.map(room, policy), jnp.full(count, jnp.nan))
        none, zero = -jnp.inf * jnp.ones(()), jnp.zeros((), jnp.int32)
        return AskState(key, zero, mean, policy, starts, none, mean, policy, tried)

    def tell(self, state: AskState, trajectory: Any) -> tuple[AskState, TrialInfo]:
        """The state after a trial of its policy that came to `trajectory`."""
        score = self.task.score(trajectory)
        best, better, tried = self._best(state, score)
        obs = jnp.concatenate([2.0 * state.mean - 1.0, self.task.observe(trajectory)])
        action = self.bdq.greedy(self.weights, obs)
        state = self._at(state, int(state.told + 1), action)
        score_at, mean_at, policy_at = best
        after = state._replace(
            best_score=score_at, best_mean=mean_at, best_policy=policy_at, tried=tried
        )
        return after, TrialInfo(score, action, better)

    def skip(self, state: AskState) -> AskState:
        """The robot cannot run this policy: its start is given up, and the next one asked for."""
        visits = self.iterations + 1
        return self._at(state, (int(state.told) // visits + 1) * visits, None)

    def trials(self, state: AskState) -> int:
        """How many there are in all."""
        return state.starts.mean.shape[0] * (self.iterations + 1)

    def _at(self, state: AskState, count: int, action: Any) -> AskState:
        """The state once `count` trials are over, the last of which was followed by `action`."""
        mean, policy = self._next(state, action, count)
        policy = self._train(jax.random.fold_in(state.key, count), mean, policy)
        return state._replace(told=jnp.asarray(count, jnp.int32), mean=mean, policy=policy)

    def _next(self, state: AskState, action: Any, count: int) -> tuple[Array, Any]:
        start, iteration = divmod(count, self.iterations + 1)
        if iteration == 0:  # the next start, or the last one again once all is over
            index = min(start, self.trials(state) // (self.iterations + 1) - 1)
            return jax.tree.map(lambda x: x[index], tuple(state.starts))
        size = self.delta * self.shrink ** (iteration - 1)
        space = self.task.space
        return spaces.step(space, gaussian(space, state.mean), action, size).mean, state.policy

    def _best(self, state: AskState, score: Array) -> tuple[tuple[Any, Any, Any], Any, Any]:
        """(Return, mean and policy) of the best trial, whether that is this one, and all trials."""
        before = (state.best_score, state.best_mean, state.best_policy)
        if not self.task.doubt:
            better = jnp.isfinite(score) & (score > state.best_score)
            own = (score, state.mean, state.policy)
            return _choose(better, own, before), better, ()
        new = Tried(state.mean, state.policy, score)
        tried = jax.tree.map(lambda every, one: every.at[state.told].set(one), state.tried, new)
        best = best_visit(smoothed(tried.mean, tried.score, self.task.doubt)[None])[1]
        some = jnp.any(jnp.isfinite(tried.score))
        picked = jax.tree.map(lambda x: x[best], (tried.score, tried.mean, tried.policy))
        return _choose(some, picked, before), some & (best == state.told), tried


def _choose(on: Array, new: Any, old: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(on, a, b), new, old)


def loop_of(trained: Trained, iterations: int, task: Task | None = None) -> AskTell:
    """The learned adaptation policy at work. task: Another than the run's own to score by."""
    phase1, hyper = trained.phase1, trained.hyper
    sizes = {name: float(getattr(hyper, name)) for name in ("delta", "shrink")}
    weights = trained.state.learner.target
    return AskTell(task or phase1.task, phase1.bdq, weights, iterations=iterations, **sizes)


def begun(loop: AskTell, trained: Trained, starts: int, seed: int) -> AskState:
    """Before any trial, from `starts` members of the run's own S_E."""
    start_key, key = jax.random.split(jax.random.key(seed))
    used = archive_size(trained.phase1, trained.rounds)
    archive = trained.state.archive
    return loop.init(key, draw_starts(start_key, archive, used, starts, loop.task.first))


class Asked(NamedTuple):
    """What to run now: `params`, E's mean by name in SI units; `policy`, the task's own, a pytree.
    Number of the trial, from 1, of how many; act: `(obs [..., O]) -> action [..., A]`, of tasks
    whose policies are called at each step, else None.
    """

    params: dict[str, float]
    policy: Any
    trial: int
    trials: int
    act: Callable[[np.ndarray], np.ndarray] | None


class Session:
    """Ask and tell with a trained run, so that Isaac Lab, mjlab, MuJoCo or a robot can be the
    target.

        session = Session("runs/e", starts=1, iterations=5)
        while not session.done:
            asked = session.ask()
            ...                                     run asked.act, or asked.policy, in the target
            session.tell(episode_return, observation)

    Args:
        run: The folder of `adaptsim train`, or a `Trained`.
        starts, iterations: `starts (iterations + 1)` trials in all, each of `task.trials` episodes
                whose returns are averaged.
        seed: Of the starts, drawn from the run's own S_E.
    """

    def __init__(
        self,
        run: str | os.PathLike | Trained,
        *,
        starts: int = 2,
        iterations: int = 10,
        seed: int = 0,
    ):
        self.trained = run if isinstance(run, Trained) else load_run(RunFolder.open(run))
        self.task = self.trained.phase1.task
        measured = replace(self.task, score=lambda t: t[0], observe=lambda t: t[1])
        self.loop = loop_of(self.trained, iterations, measured)
        self.state = begun(self.loop, self.trained, starts, seed)

    @property
    def done(self) -> bool:
        """Whether all is told."""
        return int(self.state.told) >= self.loop.trials(self.state)

    def ask(self) -> Asked:
        """What to run now; once all is told, the best."""
        if self.done:
            return self.best()
        return self._asked(self.state.mean, self.state.policy)

    def best(self) -> Asked:
        """The policy whose trial returned most so far, or where the task has its doubts of single
        trials the most expected.
        """
        return self._asked(self.state.best_mean, self.state.best_policy)

    def tell(self, score: float, observation: Any) -> bool:
        """What the trial came to: its return (more is better), and `observation [obs_dim]` as
        `task.observe` gives it (for an environment, `observed` makes it of an episode's rows).
        Returns whether it is the best so far.
        """
        if self.done:
            raise BadInput(
                f"all {self.loop.trials(self.state)} trials are told; begin another Session"
            )
        obs = jnp.asarray(observation, jnp.float32)
        if obs.shape != (self.task.obs_dim,):
            raise BadInput(
                f"tell: the observation has the shape {obs.shape}; ({self.task.obs_dim},) is wanted"
            )
        if not np.isfinite(np.asarray(obs)).all():
            raise BadInput(
                "tell: the observation is not finite; for a trial that failed tell its last sound "
                "values"
            )
        self.state, info = self.loop.tell(self.state, (jnp.asarray(score, jnp.float32), obs))
        return bool(info.best)

    def observed(self, obs: Any, action: Any, reward: Any) -> tuple[float, np.ndarray]:
        """`(return, observation)` of an episode of an environment: `obs [T, O]` before each step,
        `action [T, A]` in [-1, 1], `reward [T]`. A shorter episode than the environment's is one
        that ended early.
        """
        if self.task.read is None:
            raise BadInput(
                f"observed: task '{self.task.name}' is told by its own measurements; see `adaptsim "
                "robot`"
            )
        trajectory = self.task.read(obs, action, reward)
        return float(self.task.score(trajectory)), np.asarray(self.task.observe(trajectory))

    def _asked(self, mean: Array, policy: Any) -> Asked:
        act = None
        if self.task.act is not None:
            step = jax.jit(jnp.vectorize(partial(self.task.act, policy), signature="(o)->(a)"))

            def acted(obs):
                return np.asarray(step(jnp.asarray(obs, jnp.float32)))

            act = acted

        return Asked(
            self.task.space.named(mean),
            policy,
            int(self.state.told) + 1,
            self.loop.trials(self.state),
            act,
        )
