"""The trials that a method has made in each target so far, for tasks whose deployed policies are
mended by them.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.baselines.arena import Arena, Lanes, Trials


class Memory:
    """Of `visits` visits by the lanes of `batch`. Lanes of one seed in one target (a method's
    starts) share what they saw.
    """

    def __init__(self, arena: Arena, batch: Lanes, visits: int):
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

    def add(self, trials: Trials) -> None:
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
