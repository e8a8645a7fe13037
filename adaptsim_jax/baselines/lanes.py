"""Batches of lanes: every target, seed and start at once; and the trials that a method has made in
each target so far.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.baselines.arena import Arena, TrialBatch


class RunLanes(NamedTuple):
    """A batch of `T x S x N` (targets, seeds, starts) laid out flat: `where [B]`, `seed [B]`, and a
    key for each.
    """

    where: np.ndarray
    seed: np.ndarray
    keys: jax.Array
    shape: tuple[int, int, int]

    def grid(self, flat: np.ndarray) -> np.ndarray:
        """`[B, ...] -> [T, S, N, ...]`."""
        return np.asarray(flat).reshape(*self.shape, *np.shape(flat)[1:])

    def at(self, number: int) -> jax.Array:
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

    keys = jax.vmap(key)(jnp.asarray(np.asarray(seeds)[s], jnp.uint32), jnp.asarray(t * starts + n))
    return RunLanes(t, s, keys, (targets, len(seeds), starts))


def two_keys(keys: jax.Array) -> tuple[jax.Array, jax.Array]:
    parts = jax.vmap(jax.random.split)(keys)
    return parts[:, 0], parts[:, 1]


def lane_keys(keys: jax.Array, count: int) -> list[jax.Array]:
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
        shared = np.broadcast_to(room[:, :, None], (T, S, N, *room.shape[2:])).reshape(
            T * S * N, *room.shape[2:]
        )
        return shared, np.arange(room.shape[2]) < flat.shape[2]
