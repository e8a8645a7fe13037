"""Where the methods of the comparison meet their targets, and what they give back: batches of
policies tried, observed and scored, whatever the engine.

A batch `[B]` holds every seed, target and start at once. Compiled code ends at the target's door,
so that a target may be Drake as well as a model in JAX. What a method is told of a target is what
its own trials showed. The mean reward over the test contexts is for the table alone.
"""

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from adaptsim_jax.core.config import Table
from adaptsim_jax.core.progress import silent
from adaptsim_jax.tasks.engine import filled_batches
from adaptsim_jax.tasks.one_shot import OneShot, TargetWorld

TOGETHER = 10  # policies trained side by side: more do not fit into a core's cache


class TrialBatch(NamedTuple):
    """`N` trials of each of `B`: contexts `[B, N, g]`, actions `[B, N, d]`, outcomes `[B, N,
    ...]`.
    """

    contexts: np.ndarray
    actions: np.ndarray
    outcomes: Any


class Observed(NamedTuple):
    """What a policy's own trials showed: `obs [B, obs_dim]`, raw return `score [B]`, and the
    `trials` `[B, N]` themselves.
    """

    obs: np.ndarray
    score: np.ndarray
    trials: TrialBatch


class Arena:
    """`targets [T, D]` (physical) in a `world`. Counts the trials that failed, by target: `failed
    [T]`, of `made [T]`, and keeps what was earned in the task's `fresh` contexts: a mean `[B]` each
    time that a batch was scored.
    """

    def __init__(self, one: OneShot, world: TargetWorld, targets: np.ndarray):
        self.one, self.world = one, world
        self.targets = np.asarray(targets, np.float32)
        self.failed, self.made = np.zeros(len(targets), int), np.zeros(len(targets), int)
        self.fresh: list[np.ndarray] = []

        def draw(key, count):
            return jax.vmap(one.draw)(jax.random.split(key, count))

        def each(key, policy):
            return draw(key, one.trials)

        self._draw = jax.jit(jax.vmap(draw, (0, None)), static_argnums=1)

        self._aim = jax.jit(jax.vmap(one.aim or each))
        self._act = jax.jit(jax.vmap(one.act))
        self._act_tests = jax.jit(jax.vmap(one.act, (0, None)))
        self._explore = jax.jit(jax.vmap(one.explore))
        self._reward = jax.jit(jax.vmap(jax.vmap(one.reward)))
        self._observe = jax.jit(jax.vmap(self._look))
        self._train = jax.jit(jax.vmap(one.task.train))

    def _look(self, policy, contexts, outcomes):
        trajectory = self.one.trajectory(contexts, outcomes)
        if self.one.expect is not None:
            trajectory = self.one.expect(trajectory, policy)
        return self.one.task.observe(trajectory), self.one.task.score(trajectory)

    def train(self, keys, dists, policies):
        """Task policies `[B, ...]` trained on `dists [B]`, going on from `policies`: one compiled
        program for every `B`.
        """
        B, work = len(keys), (keys, dists, policies)
        parts = [
            self._train(*jax.tree.map(lambda x, rows=rows: x[rows], work))
            for _, rows in filled_batches(B, TOGETHER)
        ]
        return jax.tree.map(lambda *x: jnp.concatenate(x)[:B], *parts)

    def program(self, name: Hashable, function: Callable) -> Callable:
        """`function(task, *args)` of the arena's task, compiled; an arena that knows more of its
        task keeps it by its name.
        """
        del name
        return jax.jit(partial(function, self.one.task))

    def untrained(self, keys):
        """Policies `[B, ...]` as the task starts them."""
        return jax.jit(jax.vmap(self.one.task.init_policy))(keys)

    def contexts(self, keys, count: int) -> np.ndarray:
        """`[B, count, g]` drawn as the task draws them."""
        return np.asarray(self._draw(keys, count))

    def visit(self, keys, where: np.ndarray, policies) -> Observed:
        """Run each policy in its target `where [B]` for a visit's trials, and observe them."""
        contexts = np.asarray(self._aim(keys, policies))
        actions = np.asarray(self._act(policies, jnp.asarray(contexts)))
        outcomes = self.run(where, contexts, actions)
        obs, score = self._observe(policies, jnp.asarray(contexts), outcomes)
        return Observed(np.asarray(obs), np.asarray(score), TrialBatch(contexts, actions, outcomes))

    def explored(self, keys, where: np.ndarray, policies, count: int) -> TrialBatch:
        """`count` trials of each policy with its learner's own noise."""
        parts = jax.vmap(jax.random.split)(keys)
        contexts = self.contexts(parts[:, 0], count)
        actions = np.asarray(self._explore(parts[:, 1], policies, jnp.asarray(contexts)))
        return TrialBatch(contexts, actions, self.run(where, contexts, actions))

    def score(self, where: np.ndarray, policies) -> np.ndarray:
        """Mean reward `[B]` over the test contexts."""
        return self.score_actions(
            where, np.asarray(self._act_tests(policies, jnp.asarray(self.one.scored)))
        )

    def score_actions(self, where: np.ndarray, actions: np.ndarray) -> np.ndarray:
        """The same for `actions [B, G + F, d]`, one for each of the task's `scored` contexts."""
        contexts = np.broadcast_to(self.one.scored, (len(where), *self.one.scored.shape))
        rewards = np.asarray(
            self._reward(self.run(where, contexts, actions), jnp.asarray(contexts))
        )
        count = len(self.one.tests)
        if self.one.fresh is not None:
            self.fresh.append(rewards[:, count:].mean(1))
        return rewards[:, :count].mean(1)

    def run(self, where: np.ndarray, contexts: np.ndarray, actions: np.ndarray) -> Any:
        """Outcomes `[B, N, ...]` of `actions [B, N, d]` in each one's target."""
        B, N = actions.shape[:2]

        def flat(x):
            return np.ascontiguousarray(x).reshape(B * N, *x.shape[2:])

        params = np.repeat(self.targets[where], N, 0)
        outcomes, codes = self.world.run(params, flat(contexts), flat(actions))
        np.add.at(self.failed, np.repeat(where, N), codes != 0)
        np.add.at(self.made, np.repeat(where, N), 1)
        return jax.tree.map(lambda x: np.asarray(x).reshape(B, N, *np.shape(x)[1:]), outcomes)


class Visits(NamedTuple):
    """What a method did, of T targets, S seeds, N starts and I + 1 visits.

    * means `[T, S, N, I + 1, D]` of E in unit coordinates; None where it adapts no E
    * spent: Target trials of one target by one seed, cumulated over visits `[I + 1]`, or in all
    * rewards `[T, S, N, I + 1]` of its policies over the test contexts; None where the comparison
      works them out of the means (tasks whose policy is solved exactly)
    * fresh: The same over the task's fresh contexts, None where it has none
    """

    means: np.ndarray | None
    spent: np.ndarray | int
    rewards: np.ndarray | None = None
    fresh: np.ndarray | None = None

    @property
    def target_trials(self) -> int:
        return int(np.max(self.spent))


@dataclass
class MethodRun:
    """What a method is given: the comparison's config, the arena of its targets, seeds `[S]`, a
    report, and what several methods start from, such as UDR's policies.
    """

    config: Any
    arena: Any
    seeds: np.ndarray
    report: Callable[..., None] = silent
    shared: Table = field(default_factory=dict)

    @property
    def targets(self) -> np.ndarray:
        """`[T, D]`, physical."""
        return self.arena.targets

    @property
    def problem(self) -> Any:
        """Costs and policies of a task that is solved exactly (`bounds.ExactProblem`)."""
        return self.arena.problem


# ---------------------------------------------------------------- lanes
#
# Batches of lanes: every target, seed and start at once; and the trials that a method has made in
# each target so far.


class RunLanes(NamedTuple):
    """A batch of `T x S x N` (targets, seeds, starts) laid out flat: `where [B]`, `seed [B]`, and a
    key for each.
    """

    where: np.ndarray
    seed: np.ndarray
    keys: Array
    shape: tuple[int, int, int]

    def grid(self, flat: np.ndarray) -> np.ndarray:
        """`[B, ...] -> [T, S, N, ...]`."""
        return np.asarray(flat).reshape(*self.shape, *np.shape(flat)[1:])

    def at(self, number: int) -> Array:
        """Keys `[B]` of a visit."""
        return jax.vmap(jax.random.fold_in, (0, None))(self.keys, number)


def lanes(targets: int, seeds: np.ndarray, starts: int, label: int) -> RunLanes:
    """Every target, seed and start. `label` tells methods apart, so that no two of them share
    randomness.
    """
    t, s, n = (
        x.ravel()
        for x in np.meshgrid(range(targets), range(len(seeds)), range(starts), indexing="ij")
    )

    def key(seed, lane):
        return jax.random.fold_in(jax.random.fold_in(jax.random.key(seed), label), lane)

    lane_seeds = jnp.asarray(np.asarray(seeds)[s], jnp.uint32)
    keys = jax.vmap(key)(lane_seeds, jnp.asarray(t * starts + n))
    return RunLanes(t, s, keys, (targets, len(seeds), starts))


def two_keys(keys: Array) -> tuple[Array, Array]:
    parts = jax.vmap(jax.random.split)(keys)
    return parts[:, 0], parts[:, 1]


def lane_keys(keys: Array, count: int) -> list[Array]:
    """`count` keys `[B]` of each of `keys [B]`, folded by their number."""
    return [jax.vmap(jax.random.fold_in, (0, None))(keys, i) for i in range(count)]


class Memory:
    """Of `visits` visits by the lanes of `batch`. Lanes of one seed in one target (a method's
    starts) share what they saw.
    """

    def __init__(self, arena: Arena, batch: RunLanes, visits: int):
        self._one, self._batch, self._visits = arena.one, batch, visits
        self._actions, self._outcomes = [], []
        if arena.one.remember:
            self._mend = jax.jit(jax.vmap(arena.one.remember, (0, 0, 0, None)))
        else:
            self._mend = None
        if arena.one.probe:
            self._probe = jax.jit(jax.vmap(arena.one.probe))
        else:
            self._probe = None

    def add(self, trials: TrialBatch) -> None:
        """A visit's trials `[B, N]`."""
        self._actions.append(trials.actions)
        self._outcomes.append(trials.outcomes)

    def deployed(self, policies: Any, visits: int | None = None) -> Any:
        """`policies [B, ...]` as they would be deployed after the first `visits` of those so far
        (all): mended by them, where the task does that.
        """
        if self._mend is None or not self._actions:
            return policies
        actions, used = self._pooled(self._actions)
        if visits is not None:
            used = used & (np.arange(len(used)) < visits * len(used) // self._visits)
        outcomes = jax.tree.map(lambda *x: self._pooled(x)[0], *self._outcomes)
        return self._mend(
            policies, jnp.asarray(actions), jax.tree.map(jnp.asarray, outcomes), jnp.asarray(used)
        )

    def visiting(self, policies: Any) -> Any:
        """`policies [B, ...]` as they make their next visit: with a probe, where the task makes
        any.
        """
        if self._probe is None:
            return policies
        return self._probe(self.deployed(policies))

    def _pooled(self, visits) -> tuple[np.ndarray, np.ndarray]:
        """Visits `[B, n, ...]` as `[B, K, ...]`, K all that the whole of the method will make, and
        which are there `[K]`.
        """
        T, S, N = self._batch.shape
        grid = np.stack([self._batch.grid(v) for v in visits], 2)  # [T, S, visits, N, n, ...]
        rest = grid.shape[5:]
        per_visit = N * grid.shape[4]
        flat = grid.reshape(T, S, len(visits) * per_visit, *rest)
        room = np.zeros((T, S, self._visits * per_visit, *rest), flat.dtype)
        room[:, :, : flat.shape[2]] = flat
        shared = np.broadcast_to(room[:, :, None], (T, S, N, *room.shape[2:]))
        shared = shared.reshape(T * S * N, *room.shape[2:])
        return shared, np.arange(room.shape[2]) < flat.shape[2]
