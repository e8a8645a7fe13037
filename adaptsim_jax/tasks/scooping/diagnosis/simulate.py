"""Scoops simulated with the values of a diagnosis, in lots of `LANES`: so few stay in a processor's
cache, and one program serves any number of them, a lot on each core. And what a camera tells of
them.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core.parallel import cores
from adaptsim_jax.tasks.camera_effects import happened, viewed
from adaptsim_jax.tasks.scooping import lacking
from adaptsim_jax.tasks.scooping.diagnosis.catalogue import CAMERA, QUANTITIES
from adaptsim_jax.tasks.scooping.diagnosis.read import Scooped
from adaptsim_jax.tasks.scooping.hydro import Numerics
from adaptsim_jax.tasks.scooping.model import SHAPES, ScoopOptions

Array = Any
NAMES = tuple(q.name for q in QUANTITIES)
INDEX = {n: i for i, n in enumerate(NAMES)}
OWN = np.array([i for i, n in enumerate(NAMES) if n not in CAMERA])
"""Places of the quantities that a simulation depends on."""
LANES, EVERY = 8, 2
ROW = EVERY * Numerics().dt  # s between rows of simulated poses


def _poses(values: Array, g: Array, action: Array, aside: Array, options: ScoopOptions) -> Array:
    """`[N, 2]` m: x from where the piece lies and z, every `ROW` s."""
    v = {n: values[i] for i, n in enumerate(NAMES)}
    inner = {k: v[k] for k in ("mu", "h", *lacking.NEUTRAL)} | {"e": 10.0 ** v["log_e"], "g": g}
    inner["start_x"] = v["start_x"] + v["placed"] * aside[0]
    return lacking.rollout(inner, action, options)[::EVERY, :2]


@lru_cache(maxsize=8)
def _program(options: ScoopOptions) -> Callable:
    return jax.jit(jax.vmap(lambda v, g, action, aside: _poses(v, g, action, aside, options)))


def poses(
    scooped: Scooped, shape: str, values: np.ndarray, trials: np.ndarray, actions: np.ndarray
) -> np.ndarray:
    """`[B, N, 2]` m of `values [B, P]` with `actions [B, 3]` as executed, in the scoops `trials
    [B]` of the recording.
    """
    program, count = _program(scooped.options), len(values)
    g = np.full(LANES, float(SHAPES.index(shape)), np.float32)
    given = [np.asarray(a, np.float32) for a in (values, actions, scooped.aside[trials])]

    def lot(k):
        lanes = np.minimum(np.arange(k, k + LANES), count - 1)
        v, a, aside = (z[lanes] for z in given)
        return np.asarray(program(v, g, a, aside))[: count - k]

    with ThreadPoolExecutor(cores()) as pool:
        return np.concatenate(list(pool.map(lot, range(0, count, LANES))))


def seen(values: Array, poses: Array, start: Array, aside: Array, time: Array) -> Array:
    """`[R, 3]` m: what the camera tells at `time [R]` of simulated `poses [N, 2]`."""
    v = {n: values[i] for i, n in enumerate(NAMES)}
    place = jnp.clip(happened(v, time) / ROW, 0.0, len(poses) - 1.0)
    k = jnp.clip(jnp.floor(place).astype(int), 0, len(poses) - 2)
    u = (place - k)[:, None]
    xz = (1.0 - u) * poses[k] + u * poses[k + 1]
    origin = start + jnp.stack([v["start_x"], v["start_y"]]) + v["placed"] * aside
    xy = viewed(
        v, jnp.stack([origin[0] + xz[:, 0], jnp.broadcast_to(origin[1], time.shape)], 1), xz[:, 1:]
    )
    return jnp.concatenate([xy, ((1.0 + v["scale"]) * xz[:, 1] + v["shift_z"])[:, None]], 1)


_view = jax.jit(jax.vmap(seen))


def places(
    scooped: Scooped, values: np.ndarray, poses: np.ndarray, trials: np.ndarray
) -> np.ndarray:
    """`[B, R, C]` m: what the camera would say of `poses [B, N, 2]`."""

    def single(a):
        return np.asarray(a[trials], np.float32)

    rows = single(scooped.starts), single(scooped.aside), single(scooped.time)
    out = _view(np.asarray(values, np.float32), np.asarray(poses, np.float32), *rows)
    return np.asarray(out, float)[..., : scooped.places.shape[-1]]


def expected(scooped: Scooped, shape: str, values: np.ndarray, copies: int = 8) -> np.ndarray:
    """`[T, R, C]` m: the mean over copies of each scoop, as an arm repeats it; values `[T, P]`,
    each scoop with its own.
    """
    trials = np.repeat(np.arange(len(values)), copies)
    actions = scooped.actions[trials] + executed(scooped, len(trials))
    every = np.repeat(values, copies, 0)
    mean = poses(scooped, shape, every, trials, actions).reshape(len(values), copies, -1, 2).mean(1)
    return places(scooped, values, mean, np.arange(len(values)))


def executed(scooped: Scooped, count: int, seed: int = 0) -> np.ndarray:
    """Errors `[count, 3]` with which an arm repeats an action, in pairs of opposite ones."""
    half = np.random.default_rng(seed).standard_normal(((count + 1) // 2, 3))
    return np.array(scooped.repeats) * np.stack([half, -half], 1).reshape(-1, 3)[:count]
