"""What may be wrong with an environment that only shows when it runs: functions that are not pure,
fields that do nothing.
"""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.environments.interface import Play

NOTHING = 1e-5  # of what is seen, in its own spread: single precision alone moves it by less


def check_pure(play: Play, values: np.ndarray) -> None:
    """BadInput where two traces of a reset and a step differ: the environment keeps a state of its
    own, or draws without a key.
    """

    def run(key, values):
        world = play.world(values)
        live = play.step(world, play.reset(world, key), jnp.zeros(play.sim.action_dim))
        return live.obs, live.reward, live.done

    # a function that JAX has traced before is not called again, so each trace is of one of its own
    traces = [jax.make_jaxpr(lambda key, values: run(key, values)) for _ in range(2)]
    first, second = (trace(jax.random.key(0), jnp.asarray(values, jnp.float32)) for trace in traces)
    arrays = all(
        np.array_equal(a, b) for a, b in zip(first.consts, second.consts, strict=False) if _plain(a)
    )
    if str(first.jaxpr) != str(second.jaxpr) or not arrays:
        raise BadInput(
            f"env: {play.sim.name} is not pure: called twice alike, reset and step do not do the "
            f"same; draw from the key "
            "alone, and keep what changes in the state"
        )


def _plain(x: object) -> bool:
    return hasattr(x, "dtype") and not jnp.issubdtype(x.dtype, jax.dtypes.prng_key)  # type: ignore[attr-defined]


def check_fields(names: Sequence[str], seen: Callable[[jax.Array], np.ndarray]) -> None:
    """BadInput names a field that nothing follows from: `seen(u [N, D]) -> [N, K]` features of the
    same episode at points of Omega.
    """
    D = len(names)
    spread = np.random.default_rng(0).uniform(size=(4, 1, 1, D))
    points = np.tile(spread, (1, D, 2, 1))
    for i in range(D):
        points[:, i, :, i] = (0.0, 1.0)
    found = np.asarray(seen(jnp.asarray(points.reshape(-1, D), jnp.float32))).reshape(4, D, 2, -1)
    scale = np.nanstd(found.reshape(-1, found.shape[-1]), 0) + 1e-3
    moved = np.nanmax(np.abs(found[:, :, 1] - found[:, :, 0]) / scale, axis=(0, 2))
    still = [name for name, by in zip(names, moved, strict=True) if not by > NOTHING]
    if still:
        raise BadInput(
            f"fields: nothing that is seen follows from '{still[0]}' anywhere in its range; leave "
            f"it out, or widen it"
        )
