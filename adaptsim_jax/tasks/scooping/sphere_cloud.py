"""The piece of food as a cloud of spheres, for engines of rigid bodies (MuJoCo, MJX): same mass and
outline, softness by substitutes.

A point contact has no pressure field. What a soft surface does to a scoop is imitated twice: rims
are rounded, the softer the more, for a blade's edge presses a soft rim away and a sharp one stops
it; and contacts are springs, as deep at rest as the hydroelastic piece, within what a step of the
engine can resolve. The scene is symmetric about the plane of the motion, and blade and table are
flat across it, so all spheres lie in that plane: of an ellipsoid on its medial axis, of a cylinder
or a box along both flat ends. Shape and all numbers are traced; every piece has as many spheres.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from adaptsim_jax.tasks.scooping import hydro_shapes as shapes
from adaptsim_jax.tasks.scooping import model

Array = Any

SPHERES = 11
ROW = (SPHERES - 1) // 2  # along each flat end
RIM = ((1e4, 6e-3), (5e5, 1e-3))
"""(modulus Pa, radius of the rim m), twice; logarithmic in between and a little beyond. Of ten
tried, nearest to `hydro`.
"""
MIN_RIM, SLACK = 5e-4, 1e-4
IMPEDANCE = 0.5
"""Share of a contact's acceleration that MuJoCo's constraints take over; constant, so that springs
are linear.
"""
RELAXATION = 0.2  # s: damping by stiffness, as in `hydro.Numerics`


class Cloud(NamedTuple):
    """centres `[SPHERES, 3]` m from the piece's centre, radii `[SPHERES]` m."""

    centres: Array
    radii: Array


def cloud(params: Array) -> Cloud:
    """The spheres of the piece of `params [4]`."""
    hz = params[3] / 2
    round_x, round_z, round_radii = _medial(hz)
    flat_x, flat_z, flat_radii = _ends(hz, rim(params[1], hz))
    is_round = params[2] == model.ELLIPSOID
    x, z = jnp.where(is_round, round_x, flat_x), jnp.where(is_round, round_z, flat_z)
    return Cloud(
        jnp.stack([x, jnp.zeros_like(x), z], -1), jnp.where(is_round, round_radii, flat_radii)
    )


def rim(modulus: Array, hz: Array) -> Array:
    """Radius of the rounded rims of a flat piece `hz` m half as high, m."""
    (soft, wide), (stiff, sharp) = RIM
    u = jnp.clip(jnp.log(modulus / soft) / math.log(stiff / soft), -0.3, 1.3)
    return jnp.minimum(jnp.maximum(wide + (sharp - wide) * u, MIN_RIM), hz - SLACK)


class Spring(NamedTuple):
    """solref `[2]`: MuJoCo's direct form, (-stiffness, -damping); depth `[]` m at which the piece
    rests on the table.
    """

    solref: Array
    depth: Array


def spring(params: Array, dt: float) -> Spring:
    """Contacts as soft as the hydroelastic piece where it rests, for steps of `dt` s.

    A contact of impedance d is a pyramid of four constraints with an inverse weight of 4 mu^2 (1 +
    mu^2) / (3 m) each, so n of them bear the piece of mass m at a depth of (2 / 3) mu^2 (1 + mu^2)
    / n (1 - d) / d g / K. K and the damping are bound by what a step resolves: a damping of 1 / dt
    takes all speed in one.
    """
    mu, d = params[0], IMPEDANCE
    piece = shapes.body(params[2], params[3])
    sink = jnp.maximum(shapes.sink(piece, params[1], model.GRAVITY), 1e-7)
    bearing = jnp.where(params[2] == model.ELLIPSOID, 1.0, float(ROW))
    load = 2.0 / 3.0 * mu**2 * (1.0 + mu**2) / bearing * (1.0 - d) / d * model.GRAVITY
    stiffness = jnp.minimum(load / sink, 0.25 / dt**2)
    damping = jnp.minimum(jnp.maximum(2 * jnp.sqrt(stiffness), RELAXATION * stiffness), 1.0 / dt)
    solref = -jnp.stack(
        [stiffness * d * d, damping * d]
    )  # MuJoCo divides them by these powers of the impedance
    return Spring(solref, load / stiffness)


def _medial(hz: Array) -> tuple[Array, Array, Array]:
    """Centres' x and z and radii `[SPHERES]` of the discs that fill an ellipse of half sizes RADIUS
    and `hz`.
    """
    t, r = np.linspace(-1.0, 1.0, SPHERES), model.RADIUS
    long, short = jnp.maximum(r, hz), jnp.minimum(r, hz)
    square = jnp.maximum(long**2 - short**2, 1e-12)
    at = jnp.asarray(t, long.dtype) * square / long
    radii = short * jnp.sqrt(jnp.maximum(1.0 - at**2 / square, 0.0))
    zero = jnp.zeros_like(at)
    return jnp.where(hz > r, zero, at), jnp.where(hz > r, at, zero), radii


def _ends(hz: Array, rim: Array) -> tuple[Array, Array, Array]:
    """The same for a rectangle with rounded corners: spheres along bottom and top, and one that
    fills the middle.
    """
    along = jnp.asarray(np.tile(np.linspace(-1.0, 1.0, ROW), 2), hz.dtype) * (model.RADIUS - rim)
    up = jnp.asarray(np.repeat([-1.0, 1.0], ROW), hz.dtype) * (hz - rim)
    middle = jnp.zeros(1, hz.dtype)
    radii = jnp.append(jnp.broadcast_to(rim, (2 * ROW,)), 0.9 * jnp.minimum(hz, model.RADIUS))
    return jnp.append(along, middle), jnp.append(up, middle), radii
