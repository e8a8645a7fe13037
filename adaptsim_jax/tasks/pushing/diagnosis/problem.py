"""Pushes as a `Problem`: what a camera would see of each slide, less what it saw, over its
noise.
"""

import itertools
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.diagnosis.problem import Problem
from adaptsim_jax.effects.base import Effect
from adaptsim_jax.tasks.camera_effects import happened, turned, viewed
from adaptsim_jax.tasks.pushing import model, slide
from adaptsim_jax.tasks.pushing.diagnosis.catalogue import DECLARED, EFFECTS, QUANTITIES, physical
from adaptsim_jax.tasks.pushing.diagnosis.read import Pushed
from adaptsim_jax.tasks.pushing.model import PushOptions
from adaptsim_jax.tasks.pushing.planar import PlanarCoefficients

Array = Any
NAMES = tuple(q.name for q in QUANTITIES)
TURNING = ("spin", "com_x", "com_y")
WIDTHS = (8, 40)  # numbers of columns that are compiled
ASIDE = 0.2  # of a quantity's scale, to either side of where a column is taken
ROUGH = 0.0025  # s, step of the scan for starts
MARGIN = 0.05  # s simulated beyond the last row
BEGINNINGS = (
    (0.07, 0.13, 0.25),
    (4.2, 5.0, 5.6, 6.4),
    (0.15, 0.6),
    (-0.12, -0.06, 0.0, 0.06, 0.12),
)
"""Values of mu, log_e, mu_p and y_p from which the declared fit may begin."""


def observed(
    values: Array,
    push: dict[str, Array],
    options: PushOptions,
    coefficients: PlanarCoefficients,
    step: float,
    turns: bool,
    yaw: bool,
) -> Array:
    """`[R, C]` m: what the camera says of one push at `push["time"]`; values `[P]`. turns: whether
    the bottle may turn; yaw: whether the camera tells it, in rad beside x and y.
    """
    v = physical({n: values[i] for i, n in enumerate(NAMES)})
    inner = {n: v[n] for n in (*model.PARAMETERS, *slide.NEUTRAL)}
    if not turns:  # a fifth of the work
        inner |= dict.fromkeys(TURNING, 0.0)
    start = push["start"] + v["placed"] * push["aside"]
    rows = slide.rollout(inner, push["action"], options, coefficients, start, step)
    time = happened(v, push["time"])
    at = at_times(rows[:, :2], rows[:, 2:4], time)
    origin = jnp.asarray(model.START)[None]
    local = origin + (1.0 + v["scale_start"]) * turned(at - origin, v["turn_start"])
    places = viewed(v, local, model.HEIGHT)
    if not yaw:
        return places
    if turns:
        turn = at_times(rows[:, 4:5], rows[:, 5:6], time)
    else:
        turn = jnp.zeros_like(places[:, :1])
    return jnp.concatenate([places, turn], 1)


def at_times(places: Array, rates: Array, time: Array) -> Array:
    """`[R, C]` at times `[R]` s between `places` and their `rates` `[N, C]` at the rows of
    `slide.rollout`, by Hermite's cubics. Held before and after.
    """
    place = jnp.clip(time / slide.ROW, 0.0, len(places) - 1.0)
    k = jnp.clip(jnp.floor(place).astype(int), 0, len(places) - 2)
    u = (place - k)[:, None]
    h = slide.ROW
    from_row = (1 + 2 * u) * (1 - u) ** 2 * places[k] + u * (1 - u) ** 2 * h * rates[k]
    return from_row + u * u * (3 - 2 * u) * places[k + 1] + u * u * (u - 1) * h * rates[k + 1]


@lru_cache(maxsize=8)
def _program(options: PushOptions, coefficients: PlanarCoefficients, step: float, yaw: bool):
    """`(values [T, P], pushes) -> [T, R, C]` m (and rad)."""

    def make(turns):
        return partial(
            observed, options=options, coefficients=coefficients, step=step, turns=turns, yaw=yaw
        )

    flat, turning = (jax.jit(jax.vmap(make(turns))) for turns in (False, True))
    spin = NAMES.index("spin")
    return lambda values, pushes: (turning if np.any(values[:, spin]) else flat)(
        np.asarray(values, np.float32), pushes
    )


def packed(pushed: Pushed) -> dict[str, Array]:
    """Actions, starts and times of all pushes as arrays, rows padded with the last."""
    return {
        "action": np.asarray(pushed.actions, np.float32),
        "start": np.asarray(pushed.starts, np.float32),
        "aside": np.asarray(pushed.aside, np.float32),
        "time": np.asarray(pushed.time, np.float32),
    }


def prepare(
    pushed: Pushed,
    options: PushOptions,
    coefficients: PlanarCoefficients,
    effects: Sequence[Effect] = EFFECTS,
    step: float = slide.STEP,
) -> Problem:
    """The problem of a recording, simulated up to its last row."""
    last = np.ceil((float(pushed.time.max()) + MARGIN) / 0.05) * 0.05
    options = replace(options, duration=float(np.round(max(last, model.PUSH_ENDS), 3)))
    simulate, rough = (
        _program(options, coefficients, z, pushed.yaw is not None) for z in (step, ROUGH)
    )
    pushes = packed(pushed)
    places, known = pushed.places, pushed.known
    weight = known / pushed.sizes
    count = len(pushed.names)

    def free(z: np.ndarray) -> np.ndarray:
        return _without_marker_turn(z, known)

    def residuals(values: np.ndarray) -> np.ndarray:
        out = simulate(values, pushes)
        return free(weight * (places - np.asarray(out, float))).reshape(count, -1)

    def every(times):
        return {k: np.tile(v, (times, *[1] * (v.ndim - 1))) for k, v in pushes.items()}

    def columns(values: np.ndarray, basis: np.ndarray) -> np.ndarray:
        # central differences over a fifth of a step that matters, all at once: faster here than
        # forward-mode columns, and they smooth what a track does as it meets the patch's edge
        width = next(w for w in WIDTHS if w >= len(basis))
        moves = np.zeros((2, width, basis.shape[1]))
        moves[0, : len(basis)], moves[1, : len(basis)] = ASIDE * basis, -ASIDE * basis
        rows = np.repeat((values + moves).reshape(2 * width, -1), count, 0)
        out = np.asarray(simulate(rows, every(2 * width)), float)
        up, down = out.reshape(2, width, *places.shape)[:, : len(basis)]
        slopes = free(weight * (up - down) / (2 * ASIDE))
        return slopes.reshape(len(basis), count, -1).transpose(1, 2, 0)

    def scan(rows: np.ndarray) -> np.ndarray:
        out = np.asarray(rough(np.repeat(rows, count, 0), every(len(rows))), float)
        r = free(weight * (places - out.reshape(len(rows), *places.shape)))
        return np.square(r).reshape(len(rows), -1).sum(1)

    return Problem(
        QUANTITIES,
        DECLARED,
        tuple(effects),
        residuals,
        columns,
        known.sum((1, 2)) - known[..., 2:].any(1).sum(-1),
        pushed.names,
        _starts(),
        scan,
        channels=len(pushed.channels),
        again=DECLARED,
    )


def _without_marker_turn(z: np.ndarray, known: np.ndarray) -> np.ndarray:
    """`z [..., R, C]` less what a turn of the marker, which each push has of its own, takes up, in
    place; known `[T, R, C]`: what was measured.
    """
    measured = known[..., 2:]
    turn = z[..., 2:].sum(-2) / np.maximum(measured.sum(-2), 1)
    z[..., 2:] -= measured * turn[..., None, :]
    return z


def _starts() -> np.ndarray:
    """Points `[S, P]` from which the declared fit may begin."""
    neutral, names = np.array([q.default for q in QUANTITIES]), [q.name for q in QUANTITIES]
    at = [names.index(name) for name in DECLARED]
    starts = []
    for values in itertools.product(*BEGINNINGS):
        start = neutral.copy()
        start[at] = values
        starts.append(start)
    return np.array(starts)


def simulated(
    pushed: Pushed,
    options: PushOptions,
    coefficients: PlanarCoefficients,
    values: np.ndarray,
    step: float = slide.STEP,
) -> np.ndarray:
    """`[T, R, C]` m (and rad): what the camera would say of these pushes; values `[T, P]`."""
    return np.asarray(
        _program(options, coefficients, step, pushed.yaw is not None)(values, packed(pushed))
    )
