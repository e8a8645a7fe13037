"""Scooping as MuJoCo and MJX have it: the MJCF scene, the piece as a cloud of spheres, the blade's
drive, rows and codes.

A point contact has no pressure field. A cloud imitates twice what a soft surface does to a scoop.
Rims are rounded, the softer the more: a blade's edge presses a soft rim away, and a sharp one stops
it. Contacts are springs, as deep at rest as the hydroelastic piece, as far as a step resolves
them. The scene is symmetric about the plane of the motion, and blade and table are flat across it.
So all spheres lie in that plane: of an ellipsoid on its medial axis, of a cylinder or a box along
both flat ends. Shape and all numbers are traced; every piece has as many spheres.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from importlib import resources
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.tasks.engine import Trajectory, steps_a_row
from adaptsim_jax.tasks.scooping import hydro_shapes as shapes
from adaptsim_jax.tasks.scooping import model
from adaptsim_jax.tasks.scooping import motion as spatula
from adaptsim_jax.tasks.scooping.model import ScoopOptions

Array = Any

DT = 0.0025
DOFS = 6
"""Of the piece x, z m and angle rad, then of the tip; positions and velocities alike."""
PIECE = 1  # the piece's place among the bodies, after the world
HARMLESS = ((0.3, 5e4, 1.0, 0.02), (0.1, 0.0, 0.0125))


def compiled(dt: float = DT) -> Any:
    """The `mujoco.MjModel` of the shipped scene in steps of `dt` s; BadInput where rows cannot be
    cut out of such steps.
    """
    steps_a_row("scooping in MuJoCo", dt, model.ROW, DT)
    mujoco: Any = importlib.import_module("mujoco")
    text = resources.files("adaptsim_jax.tasks.scooping.engines").joinpath("scene.xml").read_text()
    spec = mujoco.MjSpec.from_string(text)
    spec.option.timestep = dt
    for i in range(SPHERES):
        spec.geom(f"sphere{i}").solimp[:2] = IMPEDANCE
    return spec.compile()


def fields(params: Array, dt: float) -> dict[str, Array]:
    """What of a compiled model belongs to the piece of `params [4]`: rows of its spheres, and
    `piece` masses and weights.

    `geom_*` are `[SPHERES, ...]`; `mass []`, `inertia []` about all axes; `weight [2]` and `weights
    [3]` are MuJoCo's inverse weights of the body (one third of the three axes' sum, of which the
    plane has two, and one) and of its joints.
    """
    spheres, body = cloud(params), shapes.body(params[2], params[3])

    def every(row):
        return jnp.broadcast_to(row, (SPHERES, *row.shape))

    light, turns = 1.0 / body.mass, 1.0 / body.inertia
    friction = jnp.stack([params[0], jnp.zeros_like(params[0]), jnp.zeros_like(params[0])])
    sizes = [spheres.radii, jnp.zeros_like(spheres.radii), jnp.zeros_like(spheres.radii)]
    return {
        "geom_pos": spheres.centres,
        "geom_size": jnp.stack(sizes, -1),
        "geom_rbound": spheres.radii,
        "geom_friction": every(friction),
        "geom_solref": every(spring(params, dt).solref),
        "mass": body.mass,
        "inertia": body.inertia,
        "weight": jnp.stack([2.0 * light, turns]) / 3.0,
        "weights": jnp.stack([light, light, turns]),
    }


def make_drive(options: ScoopOptions, dt: float) -> Callable[[Array, Array], tuple[Array, Array]]:
    """`drive(params, action) -> (start [6], accelerations [T, 3])`: positions at the start, and
    what the tip's joints are driven by, such that Euler's steps follow the prescribed motion
    exactly.
    """
    steps = round(model.SECONDS / dt)

    def drive(params: Array, action: Array) -> tuple[Array, Array]:
        pose = spatula.motion(action, steps, options)
        speed = jnp.concatenate([jnp.zeros_like(pose[:1]), jnp.diff(pose, axis=0) / dt])
        height = params[3] / 2 - spring(params, dt).depth
        piece = jnp.stack([jnp.zeros_like(height), height, jnp.zeros_like(height)])
        return jnp.concatenate([piece, pose[0]]), jnp.diff(speed, axis=0) / dt

    return drive


def fit(params: np.ndarray, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which samples the scene is made for `[B]`, and the batch with those that are not replaced by
    a harmless one.
    """
    inside = (params >= np.array(model.PHYSICAL_LOW)) & (params <= np.array(model.PHYSICAL_HIGH))
    within = np.abs(actions) <= np.array([0.35, 0.6, 0.1])
    good = np.all(inside, axis=1) & np.all(within, axis=1)

    def swap(a, harmless):
        return np.where(good[:, None], a, np.array(harmless))

    return good, swap(params, HARMLESS[0]), swap(actions, HARMLESS[1])


def finished(positions: np.ndarray, good: np.ndarray, starts: np.ndarray) -> Trajectory:
    """`positions [B, T, 6]` in rows of 10 ms as the trajectory that all engines return; finite
    whatever the code.
    """
    q = np.asarray(positions, float)
    with np.errstate(invalid="ignore"):
        finite = np.all(np.isfinite(q), axis=(1, 2))
        in_room = np.all(np.abs(q[:, :, :2]) < np.array([2.0, 1.0]), axis=(1, 2))
    codes = np.where(good, np.where(finite & in_room, model.FINE, model.DIVERGED), model.UNFIT)
    q = np.where((codes == model.FINE)[:, None, None], q, 0.0)
    state = np.zeros((*q.shape[:2], model.STATE))
    state[..., 0] = q[..., 0]
    state[..., 2] = q[..., 1]
    state[..., 3:] = q[..., 3:]
    return model.placed(state, codes, starts)


def rows(dt: float) -> slice:
    """Which of the positions after each step are rows."""
    every = round(model.ROW / dt)
    return slice(every - 1, None, every)


def jitted(
    options: ScoopOptions, dt: float
) -> Callable[[Array, Array], tuple[dict[str, Array], tuple[Array, Array]]]:
    """`fields` and drive of a batch, compiled."""
    drive = make_drive(options, dt)
    return jax.jit(jax.vmap(lambda p, a: (fields(p, dt), drive(p, a))))


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
