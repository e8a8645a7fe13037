"""Phase 2 in Python against whatever a target is: ask which policy to run, tell its return and what
was observed.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.adaptation.asktell import AskState, AskTell, make_ask_tell
from adaptsim_jax.adaptation.phase2 import draw_starts
from adaptsim_jax.adaptation.training import Trained, archive_size, load_run
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.store import RunFolder


class Asked(NamedTuple):
    """What to run now: `params`, E's mean by name in SI units; `policy`, the task's own, a pytree;
    number of the trial, from 1, of how many; act: `(obs [O]) -> action`, of tasks whose policies
    are called at each step, else None.
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
        run: the folder of `adaptsim train`, or a `Trained`.
        starts, iterations: `starts (iterations + 1)` trials in all, each of `task.trials` episodes
                whose returns are averaged.
        seed: of the starts, drawn from the run's own S_E.
    """

    def __init__(
        self,
        run: str | os.PathLike | Trained,
        *,
        starts: int = 2,
        iterations: int = 10,
        seed: int = 0,
    ):
        if isinstance(run, Trained):
            self.trained = run
        else:
            self.trained = load_run(RunFolder.open(run))
        phase1, hyper = self.trained.phase1, self.trained.hyper
        self.task = phase1.task
        told = replace(self.task, score=lambda t: t[0], observe=lambda t: t[1])
        sizes = {name: float(getattr(hyper, name)) for name in ("delta", "shrink")}
        weights = self.trained.state.learner.target
        self.loop: AskTell = make_ask_tell(
            told, phase1.bdq, weights, iterations=iterations, **sizes
        )
        start_key, key = jax.random.split(jax.random.key(seed))
        used = archive_size(phase1, self.trained.rounds)
        self.state: AskState = self.loop.init(
            key, draw_starts(start_key, self.trained.state.archive, used, starts)
        )

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
        seen = jnp.asarray(observation, jnp.float32)
        if seen.shape != (self.task.obs_dim,):
            raise BadInput(
                f"tell: the observation has the shape {seen.shape}; ({self.task.obs_dim},) is "
                f"wanted"
            )
        if not np.isfinite(np.asarray(seen)).all():
            raise BadInput(
                "tell: the observation is not finite; for a trial that failed tell its last sound "
                "values"
            )
        self.state, info = self.loop.tell(self.state, (jnp.asarray(score, jnp.float32), seen))
        return bool(info.best)

    def observed(self, obs: Any, action: Any, reward: Any) -> tuple[float, np.ndarray]:
        """`(return, observation)` of an episode of an environment: `obs [T, O]` before each step,
        `action [T, A]` in [-1, 1], `reward [T]`. A shorter episode than the environment's is one
        that ended early.
        """
        if self.task.read is None:
            raise BadInput(
                f"observed: task '{self.task.name}' is told by its own measurements; see `adaptsim "
                f"robot`"
            )
        trajectory = self.task.read(obs, action, reward)
        return float(self.task.score(trajectory)), np.asarray(self.task.observe(trajectory))

    def _asked(self, mean: jax.Array, policy: Any) -> Asked:
        names, values = self.task.space.names, np.asarray(self.task.space.physical(mean))
        act = None
        if self.task.act is not None:
            step = jax.jit(self.task.act)

            def act(obs):
                return np.asarray(step(policy, jnp.asarray(obs, jnp.float32)))

        params = dict(zip(names, map(float, values), strict=True))
        return Asked(params, policy, int(self.state.told) + 1, self.loop.trials(self.state), act)
