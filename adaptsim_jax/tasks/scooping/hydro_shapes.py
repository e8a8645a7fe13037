"""The pieces of the hydroelastic engine: pressure fields, mass, and sections by lines in the plane
of symmetry.

A soft body carries a pressure field p = e s, where s rises from 0 on its surface to 1 at its core
(Elandt et al. 2019). s is Drake's: for an ellipsoid one less the scaled radius. For a cylinder or a
box the distance to the surface by the smallest half size. Shape `g` and height are traced, so one
program serves every piece.

Coordinates are the body's: x and z in the plane of symmetry, y across it, m. `hz` is half the
height.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp

from adaptsim_jax.tasks.scooping.model import BOX, CYLINDER, DENSITY, ELLIPSOID, RADIUS

Array = Any
_TINY = 1e-12


class PieceBody(NamedTuple):
    """mass kg, inertia kg m^2 about y, g and half height hz m of one piece; each `[]`."""

    mass: Array
    inertia: Array
    g: Array
    hz: Array


class Chord(NamedTuple):
    """Where a line crosses a piece in the plane of symmetry: from `low` to `high` m along it. Equal
    where it misses.
    """

    low: Array
    high: Array


def body(g: Array, height: Array) -> PieceBody:
    """A solid piece of the food's density."""
    hz, r = height / 2, RADIUS
    volume = by_shape(g, 4 / 3 * jnp.pi * r * r * hz, 2 * jnp.pi * r * r * hz, 8 * r * r * hz)
    square = by_shape(
        g, (r * r + hz * hz) / 5, (3 * r * r + 4 * hz * hz) / 12, (r * r + hz * hz) / 3
    )
    mass = DENSITY * volume
    return PieceBody(mass, mass * square, g, hz)


def by_shape(g: Array, ellipsoid: Array, cylinder: Array, box: Array) -> Array:
    """The one of three values that belongs to the traced shape `g`."""
    return jnp.where(g == ELLIPSOID, ellipsoid, jnp.where(g == CYLINDER, cylinder, box))


def field(piece: PieceBody, x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
    """`s`, and its slopes along x and z 1/m, at points of any shape inside the piece."""
    g, hz, r = piece.g, piece.hz, RADIUS
    scaled = jnp.sqrt((x / r) ** 2 + (y / r) ** 2 + (z / hz) ** 2 + _TINY)
    round_slopes = -x / (r * r * scaled), -z / (hz * hz * scaled)
    core = jnp.minimum(r, hz)
    axis = jnp.sqrt(x * x + y * y + _TINY)
    end, side = hz - jnp.abs(z), r - axis
    wall = jnp.minimum(r - jnp.abs(x), r - jnp.abs(y))
    side = jnp.where(g == BOX, wall, side)
    along_x = jnp.where(g == BOX, -jnp.sign(x) * (jnp.abs(x) >= jnp.abs(y)), -x / axis)
    near_end = end < side
    flat = jnp.where(near_end, end, side) / core
    flat_x = jnp.where(near_end, 0.0, along_x) / core
    flat_z = jnp.where(near_end, -jnp.sign(z), 0.0) / core
    is_round = g == ELLIPSOID
    return (
        jnp.where(is_round, 1.0 - scaled, flat),
        jnp.where(is_round, round_slopes[0], flat_x),
        jnp.where(is_round, round_slopes[1], flat_z),
    )


def chord(piece: PieceBody, x: Array, z: Array, tx: Array, tz: Array) -> Chord:
    """Where the line through `(x, z)` along the unit vector `(tx, tz)` lies inside the piece."""
    r, hz = RADIUS, piece.hz
    a = (tx / r) ** 2 + (tz / hz) ** 2
    b = x * tx / r**2 + z * tz / hz**2
    c = (x / r) ** 2 + (z / hz) ** 2 - 1.0
    room = b * b - a * c
    half = jnp.where(room > 0, jnp.sqrt(jnp.maximum(room, _TINY)), 0.0)
    through_x, through_z = _slab(x, tx, r), _slab(z, tz, hz)
    low = jnp.maximum(through_x.low, through_z.low)
    high = jnp.maximum(jnp.minimum(through_x.high, through_z.high), low)
    is_round = piece.g == ELLIPSOID
    return Chord(
        jnp.where(is_round, (-b - half) / a, low), jnp.where(is_round, (-b + half) / a, high)
    )


def _slab(x: Array, t: Array, half: Array) -> Chord:
    """Where `|x + s t| <= half`; a line along the slab is inside for all s or for none."""
    steep = jnp.where(jnp.abs(t) < 1e-7, jnp.where(t < 0, -1e-7, 1e-7), t)
    one, two = (-half - x) / steep, (half - x) / steep
    return Chord(jnp.minimum(one, two), jnp.maximum(one, two))


def half_width(piece: PieceBody, x: Array, z: Array) -> Array:
    """How far the piece reaches to either side of the plane of symmetry over `(x, z)`, m."""
    across = 1.0 - (x / RADIUS) ** 2
    inside = jnp.where(piece.g == ELLIPSOID, across - (z / piece.hz) ** 2, across)
    return jnp.where(piece.g == BOX, RADIUS, RADIUS * jnp.sqrt(jnp.maximum(inside, _TINY)))


def sink(piece: PieceBody, modulus: Array, gravity: float) -> Array:
    """How deep a piece that lies on its underside sinks into a rigid table under its own weight, m.

    The field integrated over the section in closed form. Ellipsoid: e pi r^2 (d^2 - 2 d^3 / 3)
    bears the weight, with d the depth by the half height. Cylinder, box: e c (r^2 d - r d^2 + d^3 /
    3) / core, with c = pi or 4.
    """
    r, hz = RADIUS, piece.hz
    load = piece.mass * gravity / modulus
    part = load / (jnp.pi * r * r)
    flat = load * jnp.minimum(r, hz) / jnp.where(piece.g == BOX, 4.0, jnp.pi)
    round_depth, flat_depth = jnp.sqrt(part), flat / (r * r)
    for _ in range(4):
        round_depth = jnp.sqrt(part / (1.0 - 2.0 * round_depth / 3.0))
        flat_depth = flat / (r * r - r * flat_depth + flat_depth**2 / 3.0)
    return jnp.where(piece.g == ELLIPSOID, round_depth * hz, flat_depth)
