"""Contact of a soft piece with rigid flat surfaces, as points with an area, a pressure and a
stiffness.

Where a rigid surface cuts the pressure field, the cut is the contact surface and the field on it
the contact pressure (Elandt et al. 2019). A point of area A and pressure p, at which the pressure
grows by g per metre along the surface's normal, acts in the next step like a spring of stiffness k
= A g that is pressed by p / g. This is the discrete pressure field of Masterjohn et al. (2022) for
a rigid surface. Points where the pressure does not grow along the normal bear nothing, as in
Drake: so an edge can slide under a flat bottom.

Symmetry about the vertical plane is used: only one half of each section is sampled, with twice its
area.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from adaptsim_jax.tasks.scooping import model
from adaptsim_jax.tasks.scooping.hydro_shapes import PieceBody, chord, field, half_width

Array = Any


class Surfaces(NamedTuple):
    """`S` rigid strips, each a line in the plane of symmetry that is wide to both sides.

    origin, tangent `[2, S]`: `origin + s tangent` for s from `low [S]` to `high [S]` m. The normal
    is the tangent turned up by a right angle. about `[2, S]` m, velocity `[2, S]` m/s, spin `[S]`
    rad/s: rigid motion, the velocity being that of `about`. friction `[S]`: The pair's Coulomb
    coefficient.
    """

    origin: Array
    tangent: Array
    low: Array
    high: Array
    about: Array
    velocity: Array
    spin: Array
    friction: Array


class Contacts(NamedTuple):
    """`N` points, each field `[N]`: arms along x and z from the piece's centre m, tangent and
    normal, prescribed tangential and normal velocity of the surface m/s, area m^2, pressure Pa, its
    growth along the normal Pa/m, friction; `active` is 1 or 0.
    """

    rx: Array
    rz: Array
    tx: Array
    tz: Array
    slide: Array
    lift: Array
    area: Array
    pressure: Array
    growth: Array
    friction: Array
    active: Array


def touch(
    piece: PieceBody,
    modulus: Array,
    pose: Array,
    surfaces: Surfaces,
    grid: tuple[tuple[int, int], ...],
) -> Contacts:
    """Contact points of all surfaces: for each a pair of `grid`, columns along it and points across
    half of the section.

    `pose [3]`: the piece's x, z m and angle rad.
    """
    which, *places = _layout(grid)
    column, columns, node, weight = (jnp.asarray(v, pose.dtype) for v in places)
    c, s = jnp.cos(pose[2]), jnp.sin(pose[2])

    def local(x, z):
        return (c * x - s * z, s * x + c * z)  # from the world into the piece

    tx, tz = surfaces.tangent
    ox, oz = surfaces.origin[0] - pose[0], surfaces.origin[1] - pose[1]
    bx, bz = local(ox, oz)
    ux, uz = local(tx, tz)
    cut = chord(piece, bx, bz, ux, uz)
    low, high = jnp.maximum(cut.low, surfaces.low), jnp.minimum(cut.high, surfaces.high)
    every = jnp.stack(
        [tx, tz, ox, oz, bx, bz, ux, uz, low, jnp.maximum(high - low, 0.0), surfaces.friction]
    )
    motion = jnp.stack([*(surfaces.about - pose[:2, None]), *surfaces.velocity, surfaces.spin])
    of_points = jnp.concatenate([every, motion])[:, which]
    tx, tz, ox, oz, bx, bz, ux, uz, low, length, friction, ax, az, vx, vz, spin = of_points
    step = length / columns
    at = low + step * column
    x, z = bx + at * ux, bz + at * uz
    wide = half_width(piece, x, z)
    depth, slope_x, slope_z = field(piece, x, wide * node, z)
    growth = slope_z * ux - slope_x * uz
    active = (depth > 0) & (growth > 1e-6) & (step > 0)
    rx, rz = ox + at * tx, oz + at * tz
    vx, vz = vx + spin * (rz - az), vz - spin * (rx - ax)
    return Contacts(
        rx,
        rz,
        tx,
        tz,
        vx * tx + vz * tz,
        vz * tx - vx * tz,
        2.0 * step * wide * weight,
        modulus * jnp.where(active, depth, 0.0),
        modulus * jnp.where(active, growth, 1.0),
        friction,
        active.astype(pose.dtype),
    )


def _layout(grid: tuple[tuple[int, int], ...]) -> tuple[np.ndarray, ...]:
    """For each point: its surface, its column's middle, the surface's columns, its place across and
    its weight there.
    """
    parts = []
    for place, (columns, across) in enumerate(grid):
        nodes, weights = np.polynomial.legendre.leggauss(across)  # on [-1, 1]
        middle = np.repeat(np.arange(columns) + 0.5, across)

        def tiled(v, n=columns):
            return np.tile(v, n)

        full = np.ones(len(middle))
        parts.append(
            (
                place * full.astype(int),
                middle,
                columns * full,
                tiled((nodes + 1) / 2),
                tiled(weights / 2),
            )
        )
    return tuple(np.concatenate(rows) for rows in zip(*parts, strict=True))


def firsts(grid: tuple[tuple[int, int], ...]) -> tuple[int, ...]:
    """The place of each surface's first point among all of them."""
    return tuple(int(n) for n in np.cumsum([0] + [a * b for a, b in grid])[:-1])


def table(friction: Array) -> Surfaces:
    """The table alone: the plane z = 0, at rest."""
    zero = jnp.zeros((2, 1), friction.dtype)
    reach = jnp.full(1, 9.0, friction.dtype)
    along = jnp.array([[1.0], [0.0]], friction.dtype)
    return Surfaces(zero, along, -reach, reach, zero, zero, zero[0], friction[None])


def spatula(pose: Array, velocity: Array, friction: Array) -> Surfaces:
    """Top of the blade, its front, and the neck behind it, for the tip's `pose [3]` and `velocity
    [3]`.
    """
    (cx, cz), (hx, hz) = model.BLADE_CENTRE, model.BLADE_HALF
    (nx, nz), (kx, kz), rise = model.NECK_CENTRE, model.NECK_HALF, model.NECK_RISE
    behind = (nx + kz * np.sin(rise), nz + kz * np.cos(rise))
    at = np.array([(cx, cz + hz), (cx + hx, cz), behind]).T
    along = np.array([(1.0, 0.0), (0.0, -1.0), (np.cos(rise), -np.sin(rise))]).T
    c, s = jnp.cos(pose[2]), jnp.sin(pose[2])

    def out(v):
        return jnp.stack([c * v[0] + s * v[1], c * v[1] - s * v[0]])

    half = jnp.array([hx, hz, kx], pose.dtype)

    def three(v):
        return jnp.broadcast_to(v[:, None], (2, 3))

    neck = 2 * friction * model.NECK_FRICTION / (friction + model.NECK_FRICTION)
    return Surfaces(
        pose[:2, None] + out(jnp.asarray(at, pose.dtype)),
        out(jnp.asarray(along, pose.dtype)),
        -half,
        half,
        three(pose[:2]),
        three(velocity[:2]),
        jnp.broadcast_to(velocity[2], (3,)),
        jnp.stack([friction, friction, neck]),
    )


def together(first: Surfaces, second: Surfaces) -> Surfaces:
    """Both lots of surfaces as one."""
    return Surfaces(*(jnp.concatenate(pair, -1) for pair in zip(first, second, strict=True)))
