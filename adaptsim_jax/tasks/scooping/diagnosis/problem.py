"""Scoops as a `Problem` over their emulator: what a camera would see of each, less what it saw,
over what can be told beforehand.

A row's scale is the camera's noise and what the scoop strays by about its emulator. Rows where it
strays too far are left out. What then still departs (a piece that went the other way at the lip)
counts by its root, as in Huber's estimate: one scoop must not outvote the others.
"""

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.diagnosis.problem import Problem
from adaptsim_jax.effects.base import Effect, Quantity
from adaptsim_jax.tasks.scooping.diagnosis.catalogue import QUANTITIES
from adaptsim_jax.tasks.scooping.diagnosis.emulate import PLACE, REACH, Emulator, predicted
from adaptsim_jax.tasks.scooping.diagnosis.read import Scooped
from adaptsim_jax.tasks.scooping.diagnosis.simulate import INDEX, ROW, observed, places, poses

Array = Any
KNEE = 3.0  # times a row's scale, from which its residual counts by its root
STRAY = 0.02  # m, from which a row says nothing
ROUGH = 0.004  # m, a row's scale before anything is known of it
FEW = 8  # scoops by which starts are sorted
MU, LOG_E, HEIGHTS = (0.2, 0.28, 0.36, 0.48), (4.0, 4.5, 5.0, 5.6), (0.015, 0.02, 0.025)


def softened(r: Array) -> Array:
    """Residuals whose squares sum to Huber's smooth loss."""
    grown = jnp.square(r / KNEE)
    return r * jnp.sqrt(2.0 / (jnp.sqrt(1.0 + grown) + 1.0))


def scales(scooped: Scooped, stray: np.ndarray) -> np.ndarray:
    """One over the scale of each row `[T, R, C]` 1/m, 0 where it is not measured or cannot be told
    beforehand.
    """
    count, channels = len(scooped.names), scooped.places.shape[-1]
    at = np.clip(np.round(scooped.time / ROW).astype(int), 0, stray.shape[1] - 1)
    x, z = (stray[np.arange(count)[:, None], at, c] for c in range(2))
    wide = np.stack([x, np.zeros_like(x), z], -1)[..., :channels]
    known = np.maximum(x, z)[..., None] < STRAY
    return scooped.mask[..., None] * known / np.sqrt(scooped.noise**2 + np.square(wide))


class Emulated(NamedTuple):
    """An emulator's weights `[T, ...]`, and centre and width `[O]` of what it knows."""

    weights: Array
    centre: Array
    width: Array


class Measured(NamedTuple):
    """Of T scoops where each began, its camera's time, what was measured `[T, R, C]` m, and one
    over the scale of each row.
    """

    start: Array
    aside: Array
    time: Array
    places: Array
    scale: Array


@jax.jit
def _residuals(values, emulated: Emulated, measured: Measured):
    """`[T, R C]` at values `[T, P]`."""

    def one(values, weights, m: Measured):
        path = predicted(weights, emulated.centre, emulated.width, values)
        out = observed(values, path, m.start, m.aside, m.time)
        return softened(m.scale * (m.places - out[:, : m.places.shape[1]])).reshape(-1)

    return jax.vmap(one)(values, emulated.weights, measured)


@jax.jit
def _columns(values, basis, emulated: Emulated, measured: Measured):
    """`[T, R C, K]` at values `[P]` along the rows of `basis [K, P]`."""
    every = jnp.broadcast_to(values, (len(measured.time), len(values)))

    def push(b):
        def residuals(v):
            return _residuals(v, emulated, measured)

        return jax.jvp(residuals, (every,), (jnp.broadcast_to(b, every.shape),))[1]

    return -jax.vmap(push, out_axes=-1)(basis)


def prepare(
    scooped: Scooped,
    emulator: Emulator,
    effects: Sequence[Effect],
    declared: tuple[str, ...],
    quantities: tuple[Quantity, ...],
    start: np.ndarray,
) -> Problem:
    """The problem of a recording with pieces of one shape, around the emulator's centre; start
    `[P]`: of the declared fit.

    Declared values stay within the emulator's reach: what is lacking would drive them to where it
    knows nothing.
    """
    within = {q: REACH * emulator.width[PLACE[INDEX[q]]] for q in declared}
    quantities = tuple(
        _near(q, emulator.centre[PLACE[INDEX[q.name]]], within[q.name]) if q.name in within else q
        for q in quantities
    )
    count = len(scooped.names)
    scale = scales(scooped, emulator.stray)

    def single(a):
        return jnp.asarray(np.asarray(a, np.float32))

    emulated = Emulated(*map(single, (emulator.weights, emulator.centre, emulator.width)))
    seen = (scooped.starts, scooped.aside, scooped.time, scooped.places, scale)
    measured = Measured(*map(single, seen))
    neutral = np.array([q.default for q in quantities])
    begin = np.where([q.name in declared for q in quantities], start, neutral)

    def residuals(values: np.ndarray) -> np.ndarray:
        return np.asarray(_residuals(single(values), emulated, measured), float)

    def columns(values: np.ndarray, basis: np.ndarray) -> np.ndarray:
        wide = np.zeros((len(quantities), len(quantities)))  # one program for any number
        wide[: len(basis)] = basis
        made = _columns(single(values), single(wide), emulated, measured)
        return np.asarray(made, float)[..., : len(basis)]

    return Problem(
        quantities,
        declared,
        tuple(effects),
        residuals,
        columns,
        (scale > 0).reshape(count, -1).sum(1).astype(float),
        scooped.names,
        begin[None],
        channels=scooped.places.shape[-1],
    )


def _near(q: Quantity, centre: float, reach: float) -> Quantity:
    return replace(q, low=max(q.low, centre - reach), high=min(q.high, centre + reach))


def quantities_of(scooped: Scooped) -> tuple[Quantity, ...]:
    """The quantities, a declared height where it is neutral."""
    given = {} if scooped.height is None else {"h": scooped.height}
    return tuple(replace(q, default=given.get(q.name, q.default)) for q in QUANTITIES)


def begun(
    scooped: Scooped, shape: str, quantities: tuple[Quantity, ...]
) -> tuple[np.ndarray, float]:
    """The best two of a grid of declared values `[2, P]` for pieces of a shape, of different
    stiffness, and the best loss a number.
    """
    heights: tuple[float, ...] = HEIGHTS
    q = quantities[INDEX["h"]]
    if scooped.height is not None:
        heights = (scooped.height,)
    elif scooped.places.shape[-1] > 2:
        heights = (float(np.clip(2.0 * np.median(scooped.places[:, 0, 2]), q.low, q.high)),)
    points = []
    for mu, log_e, h in itertools.product(MU, LOG_E, heights):
        point = np.array([q.default for q in quantities])
        point[[INDEX[n] for n in ("mu", "log_e", "h")]] = mu, log_e, h
        points.append(point)
    some = np.unique(np.linspace(0, len(scooped.names) - 1, FEW).astype(int))
    trials, values = np.tile(some, len(points)), np.repeat(points, len(some), 0)
    out = places(
        scooped, values, poses(scooped, shape, values, trials, scooped.actions[trials]), trials
    )
    r = scooped.mask[trials][..., None] * (scooped.places[trials] - out) / ROUGH
    squares = np.square(np.asarray(softened(r))).reshape(len(points), -1)
    loss = squares.sum(1) / (3.0 * scooped.mask[some].sum())
    order = np.argsort(loss)
    best = points[order[0]]
    second = next(points[i] for i in order if points[i][INDEX["log_e"]] != best[INDEX["log_e"]])
    return np.array([best, second]), float(loss.min())
