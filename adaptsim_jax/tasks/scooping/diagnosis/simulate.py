"""A scoop with what may be lacking in the declared one: the engine of `hydro` with an offset
command, a tilted table, drag.

With `NEUTRAL` it is `hydro.rollout`, number by number. Pure and traced in all values; the shape may
be traced, too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core.parallel import cores
from adaptsim_jax.tasks.camera_effects import happened, viewed
from adaptsim_jax.tasks.engine import filled_batches
from adaptsim_jax.tasks.scooping import hydro, model
from adaptsim_jax.tasks.scooping import hydro_contact as contact
from adaptsim_jax.tasks.scooping import hydro_shapes as shapes
from adaptsim_jax.tasks.scooping import motion as spatula
from adaptsim_jax.tasks.scooping.diagnosis.catalogue import CAMERA, QUANTITIES
from adaptsim_jax.tasks.scooping.diagnosis.read import Scooped
from adaptsim_jax.tasks.scooping.model import SHAPES, Numerics, ScoopOptions

Array = Any

NEUTRAL = {
    "speed_scale": 0.0,
    "lift_scale": 0.0,
    "pitch_offset": 0.0,
    "distance_offset": 0.0,
    "start_x": 0.0,
    "clearance": 0.0,
    "tilt": 0.0,
    "drag": 0.0,
    "adhesion": 0.0,
    "blade_friction": 0.0,
}
"""Shares of the declared speed, pitch rate and the blade's friction; rad; m, how far the blade
starts farther, and the piece lies ahead; m more under the blade; rad, downhill ahead; 1/s on the
table; m/s^2 towards the blade on it.
"""
NEAR = 1e-3  # m, over which drag and adhesion fade as a piece leaves table or blade


def rollout(
    values: Mapping[str, Array],
    action: Array,
    options: ScoopOptions = ScoopOptions(),  # noqa: B008
    numerics: Numerics = Numerics(),  # noqa: B008
) -> Array:
    """Poses `[N + 1, 3]` (x m from where the piece lies, z m, angle rad) every `numerics.dt` s of
    `action [3]` (rad, rad/s, m).

    values: mu, e Pa, g, h m (`model.PARAMETERS`) and what differs from `NEUTRAL`. Where the motion
    ceases to be finite it stays.
    """
    v = {**NEUTRAL, **values}
    piece = shapes.body(v["g"], v["h"])
    more = jnp.stack(
        [v["pitch_offset"], jnp.zeros_like(v["mu"]), v["distance_offset"] + v["start_x"]]
    )
    sliding = replace(options, clearance=options.clearance + v["clearance"])
    tip = spatula.motion(
        action + more.astype(action.dtype),
        hydro.steps_of(numerics),
        sliding,
        1.0 + v["speed_scale"],
        1.0 + v["lift_scale"],
    )
    ground, blade = contact.table(v["mu"]), v["mu"] * (1.0 + v["blade_friction"])
    rest = hydro.at_rest(piece, v["e"])

    def one(carry, row):
        state, lost = carry
        now, after = row
        surfaces = contact.together(
            ground, contact.spatula(now, (after - now) / numerics.dt, blade)
        )
        pull = _pull(v, piece, rest.pose[1], state, now)
        new, _ = hydro.step(piece, v["e"], state, surfaces, numerics, pull)
        lost = lost | ~hydro.in_room(new)
        # nothing of a lost step enters derivatives either
        return (jax.tree.map(lambda a, b: jnp.where(lost, a, b), state, new), lost), state.pose

    (end, _), poses = jax.lax.scan(one, (rest, jnp.zeros((), bool)), (tip[:-1], tip[1:]))
    return jnp.concatenate([poses, end.pose[None]])


def _pull(
    v, piece: shapes.PieceBody, rest: Array, state: hydro.PieceState, tip: Array
) -> tuple[Array, Array]:
    """Acceleration along and up: gravity on a tilted table, drag near the table, adhesion near the
    blade.
    """
    x, z = state.pose[0], state.pose[1]
    on_table = jnp.exp(-jnp.maximum(z - rest, 0.0) / NEAR)
    ahead, above = spatula.from_tip(tip, x, z)
    behind_tip = jax.nn.sigmoid((-ahead) / NEAR)
    over = behind_tip * jax.nn.sigmoid((piece.hz + 3.0 * NEAR - above) / NEAR)
    stick_x, stick_z = spatula.turn(tip[2], jnp.zeros_like(x), -v["adhesion"] * over)
    slope = v["tilt"]
    along = model.GRAVITY * jnp.sin(slope) - v["drag"] * on_table * state.velocity[0] + stick_x
    return along, -model.GRAVITY * jnp.cos(slope) + stick_z


NAMES = tuple(q.name for q in QUANTITIES)
INDEX = {n: i for i, n in enumerate(NAMES)}
OWN = np.array([i for i, n in enumerate(NAMES) if n not in CAMERA])
"""Places of the quantities that a simulation depends on."""
LANES, EVERY = 8, 2
ROW = EVERY * Numerics().dt  # s between rows of simulated poses


def _poses(values: Array, g: Array, action: Array, aside: Array, options: ScoopOptions) -> Array:
    """`[N, 2]` m: x from where the piece lies and z, every `ROW` s."""
    v = {n: values[i] for i, n in enumerate(NAMES)}
    inner = {k: v[k] for k in ("mu", "h", *NEUTRAL)} | {"e": 10.0 ** v["log_e"], "g": g}
    inner["start_x"] = v["start_x"] + v["placed"] * aside[0]
    return rollout(inner, action, options)[::EVERY, :2]


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

    def lot(batch):
        v, a, aside = (z[batch[1]] for z in given)
        return np.asarray(program(v, g, a, aside))

    with ThreadPoolExecutor(cores()) as pool:
        return np.concatenate(list(pool.map(lot, filled_batches(count, LANES))))[:count]


def observed(values: Array, poses: Array, start: Array, aside: Array, time: Array) -> Array:
    """`[R, 3]` m: what the camera tells at `time [R]` of simulated `poses [N, 2]`."""
    v = {n: values[i] for i, n in enumerate(NAMES)}
    place = jnp.clip(happened(v, time) / ROW, 0.0, len(poses) - 1.0)
    k = jnp.clip(jnp.floor(place).astype(int), 0, len(poses) - 2)
    u = (place - k)[:, None]
    xz = (1.0 - u) * poses[k] + u * poses[k + 1]
    origin = start + jnp.stack([v["start_x"], v["start_y"]]) + v["placed"] * aside
    x, y = origin[0] + xz[:, 0], jnp.broadcast_to(origin[1], time.shape)
    xy = viewed(v, jnp.stack([x, y], 1), xz[:, 1:])
    z = (1.0 + v["scale"]) * xz[:, 1] + v["shift_z"]
    return jnp.concatenate([xy, z[:, None]], 1)


_view = jax.jit(jax.vmap(observed))


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
