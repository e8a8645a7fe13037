"""What MuJoCo and MJX share of scooping: the MJCF scene, what of it belongs to a sample, the
blade's drive, rows and codes; and our own engine.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from importlib import resources
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.tasks.engine import EngineKind, Trajectory, filled_batches, steps_a_row
from adaptsim_jax.tasks.scooping import hydro, interface, model
from adaptsim_jax.tasks.scooping import hydro_shapes as shapes
from adaptsim_jax.tasks.scooping import motion as spatula
from adaptsim_jax.tasks.scooping import sphere_cloud as clouds
from adaptsim_jax.tasks.scooping.hydro import Numerics
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
    steps_a_row("scooping in MuJoCo", dt, interface.ROW, DT)
    mujoco: Any = importlib.import_module("mujoco")
    text = resources.files("adaptsim_jax.tasks.scooping.engines").joinpath("scene.xml").read_text()
    spec = mujoco.MjSpec.from_string(text)
    spec.option.timestep = dt
    for i in range(clouds.SPHERES):
        spec.geom(f"sphere{i}").solimp[:2] = clouds.IMPEDANCE
    return spec.compile()


def fields(params: Array, dt: float) -> dict[str, Array]:
    """What of a compiled model belongs to the piece of `params [4]`: rows of its spheres, and
    `piece` masses and weights.

    `geom_*` are `[SPHERES, ...]`; `mass []`, `inertia []` about all axes; `weight [2]` and `weights
    [3]` are MuJoCo's inverse weights of the body (one third of the three axes' sum, of which the
    plane has two, and one) and of its joints.
    """
    spheres, body = clouds.cloud(params), shapes.body(params[2], params[3])

    def every(row):
        return jnp.broadcast_to(row, (clouds.SPHERES, *row.shape))

    light, turns = 1.0 / body.mass, 1.0 / body.inertia
    friction = jnp.stack([params[0], jnp.zeros_like(params[0]), jnp.zeros_like(params[0])])
    return {
        "geom_pos": spheres.centres,
        "geom_size": jnp.stack(
            [spheres.radii, jnp.zeros_like(spheres.radii), jnp.zeros_like(spheres.radii)], -1
        ),
        "geom_rbound": spheres.radii,
        "geom_friction": every(friction),
        "geom_solref": every(clouds.spring(params, dt).solref),
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
        height = params[3] / 2 - clouds.spring(params, dt).depth
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
        rows_at = np.all(np.isfinite(q), axis=(1, 2)) & np.all(
            np.abs(q[:, :, :2]) < np.array([2.0, 1.0]), axis=(1, 2)
        )
    codes = np.where(good, np.where(rows_at, model.FINE, model.DIVERGED), model.UNFIT)
    q = np.where((codes == model.FINE)[:, None, None], q, 0.0)
    state = np.zeros((*q.shape[:2], interface.STATE))
    state[..., 0], state[..., 2], state[..., 3:] = q[..., 0], q[..., 1], q[..., 3:]
    return interface.placed(state, codes, starts)


def rows(dt: float) -> slice:
    """Which of the positions after each step are rows."""
    every = round(interface.ROW / dt)
    return slice(every - 1, None, every)


def jitted(
    options: ScoopOptions, dt: float
) -> Callable[[Array, Array], tuple[dict[str, Array], tuple[Array, Array]]]:
    """`fields` and drive of a batch, compiled."""
    drive = make_drive(options, dt)
    return jax.jit(jax.vmap(lambda p, a: (fields(p, dt), drive(p, a))))


class HydroSettings(NamedTuple):
    """numerics: what makes up the simulator besides physics."""

    numerics: Numerics = Numerics()


def make_hydro(options: ScoopOptions, numerics: Numerics):
    """`simulate` of our own engine, in batches on the CPU."""
    hydro.check_numerics(numerics)
    every = steps_a_row("backend hydro", numerics.dt, interface.ROW, DT)

    @jax.jit
    @jax.vmap
    def run(params, action):
        out = hydro.rollout(params, action, options, numerics)
        rows = slice(every, None, every)
        return out.piece[rows, :2], out.tip[rows], out.code

    def simulate(params, commands, initial):
        params, actions, starts = interface.checked(params, commands, initial)
        count, kind = len(params), jnp.result_type(float)
        state = np.zeros((count, round(model.SECONDS / interface.ROW), interface.STATE))
        codes = np.zeros(count, int)
        for here, room in filled_batches(count, interface.BATCH):
            found = run(jnp.asarray(params[room], kind), jnp.asarray(actions[room], kind))
            piece, tip, code = (np.asarray(x)[: here.stop - here.start] for x in found)
            state[here, :, 0], state[here, :, 2] = piece[..., 0], piece[..., 1]
            state[here, :, 3:], codes[here] = tip, code
        return interface.placed(state, codes, starts)

    return simulate


HYDRO = EngineKind(HydroSettings, make_hydro)
