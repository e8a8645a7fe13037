"""The course of a policy's training: evaluated on the way, kept at its best, and taken up where it
was stopped. What went wrong is said at its end.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from adaptsim_jax.core.parallel import largest_divisor
from adaptsim_jax.core.progress import silent
from adaptsim_jax.core.store import Kept
from adaptsim_jax.environments.trainer import Trainer, Worlds

CHUNK = 10  # rounds between two looks at the training, at most


@dataclass(frozen=True)
class CourseCriteria:
    """How a training is evaluated, and when it is reported.

    episodes: Of an evaluation, the same worlds and starts each time. evaluations: Evenly over the
    second half; in the first, policies may be told no world. fell: Share of what the best policy
    returns beyond doing nothing, which the last one must have lost. deviations: Of the mean
    difference, by which a loss is no luck. diverged: Share of steps whose observation is no number;
    below it, a world at the edge of its range that blew up now and then is usual.
    """

    episodes: int = 64
    evaluations: int = 5
    fell: float = 0.1
    deviations: float = 3.0
    diverged: float = 0.01


class TrainingPlan(NamedTuple):
    """rounds: Of training. blind: For this share of the rounds, the first, no world is told. kept:
    Holds the training while it lasts, where it may be taken up again.
    """

    rounds: int
    blind: float = 0.0
    kept: Kept | None = None


class Course(NamedTuple):
    """Training so far: the trainer's state; what was learned at the best evaluation, after how many
    rounds `[]`, and the returns `[N]` there and at the last one; shares of steps that were lost
    `[2]` (see `TrainerInfo`), summed over the rounds.
    """

    state: Any
    best: Any
    best_at: Array
    best_returns: Array
    last_returns: Array
    lost: Array


def trained_in(
    trainer: Trainer,
    key: Array,
    learned: Any,
    worlds: Worlds,
    plan: TrainingPlan,
    report: Callable = silent,
    criteria: CourseCriteria = CourseCriteria(),
) -> Any:
    """What the trainer had learned in `worlds`, from `learned`, where it returned most in an
    evaluation: in chunks, so that progress shows.
    """
    rounds = plan.rounds
    begin_key, key = jax.random.split(key)
    test_key = jax.random.fold_in(begin_key, 1)
    worst = jnp.full(criteria.episodes, -jnp.inf)
    begun = trainer.begin(begin_key, learned)
    course = Course(begun, learned, jnp.zeros((), jnp.int32), worst, worst, jnp.zeros(2))
    done, episode, where = 0, float("nan"), None
    if plan.kept is not None:
        course, done = plan.kept.restore(course)
    # one compiled program serves all of it
    size = largest_divisor(min(CHUNK, rounds), rounds)
    while done < rounds:
        done += size
        known = worlds.known if done > plan.blind * rounds else jnp.zeros(())
        told = worlds._replace(known=known)
        state, info = trainer.train(key, course.state, told, size)
        lost = np.asarray(info.lost)
        if where is None and lost[:, 0].any():
            where = np.asarray(info.where)[lost[:, 0].argmax()]
        course = course._replace(state=state, lost=course.lost + lost.sum(0))
        if trainer.returns is not None and _due(done, size, rounds, criteria.evaluations):
            policy = trainer.policy(trainer.learned(state))
            mix = jnp.array([1.0, 0.0])
            found = trainer.returns(test_key, policy, worlds, mix, criteria.episodes)
            course = _evaluated(course, trainer.learned(state), found, done)
        episodes = np.asarray(info.episode)
        if np.isfinite(episodes).any():
            episode = float(np.nanmean(episodes))
        report(done, rounds, f"training the policy, return {episode:.4g}")
        if plan.kept is not None:
            plan.kept.save(course, done)
    if trainer.returns is None:
        return trainer.learned(course.state)
    policy = trainer.policy(course.best)
    idle = [
        np.asarray(trainer.returns(test_key, policy, worlds, jnp.array(mix), criteria.episodes))
        for mix in ([0.0, 0.0], [0.0, 1.0])
    ]
    for words in faults_of(course, rounds, idle, where, criteria):
        print(f"env: {words}", file=sys.stderr)
    return course.best


def _due(done: int, size: int, rounds: int, evaluations: int) -> bool:
    """Whether one of the evaluations, evenly over the second half, falls into the last `size`."""
    before, now = ((2 * at - rounds) * evaluations // rounds for at in (done - size, done))
    return now > max(before, 0) or done == rounds


def _evaluated(course: Course, learned: Any, returns: Array, done: int) -> Course:
    course = course._replace(last_returns=returns)
    if _mean(returns) < _mean(course.best_returns):
        return course
    return course._replace(best=learned, best_at=jnp.asarray(done), best_returns=returns)


def _mean(returns: Any) -> float:
    """Of those that are a number; minus infinity where none is."""
    finite = np.asarray(returns)[np.isfinite(returns)]
    return float(finite.mean()) if finite.size else -np.inf


def faults_of(
    course: Course,
    rounds: int,
    idle: list[np.ndarray],
    where: np.ndarray | None,
    criteria: CourseCriteria,
) -> list[str]:
    """What a person is told of a training that went wrong, a line each.

    Args:
        idle: Returns `[N]` of doing nothing and of random actions, in the same worlds.
        where: See `TrainerInfo`.
    """
    lines = []
    reward, diverged = (float(x) / rounds for x in course.lost)
    if reward:
        at = "" if where is None else f", first at {np.round(where, 4).tolist()}"
        lines.append(
            f"the reward is no number in {reward:.2%} of training's steps, though the observation "
            f"is{at}; mend the reward there (a root or arccos of what rounding puts beyond its "
            "range?)"
        )
    if diverged > criteria.diverged:
        lines.append(
            f"what is observed is no number in {diverged:.2%} of training's steps; narrow the "
            "fields' ranges, or take a smaller time step"
        )
    best, last = (np.asarray(x) for x in (course.best_returns, course.last_returns))
    nothing, random = map(_mean, idle)
    lead = _mean(best) - max(nothing, random)
    if not lead > 0:
        lines.append(
            f"the policy returns {_mean(best):.4g}, doing nothing {nothing:.4g}, random actions "
            f"{random:.4g}: it learned nothing of use; raise training.steps, or reward what comes "
            "near"
        )
    loss = (best - last)[np.isfinite(best - last)]
    if loss.size and loss.mean() > max(
        criteria.fell * (_mean(best) - nothing),
        criteria.deviations * loss.std() / np.sqrt(loss.size),
    ):
        lines.append(
            f"training fell from a return of {_mean(best):.4g} to {_mean(last):.4g}: the policy of "
            f"{100 * int(course.best_at) / rounds:.0f} % of it is kept; a smaller "
            "training.hyper.learning_rate may hold it"
        )
    return lines
