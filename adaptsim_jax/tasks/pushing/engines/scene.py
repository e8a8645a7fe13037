"""What the engines of the push share: batches checked, the MJCF scene as a model, codes and rows of
the outcome; and the planar model as an engine.
"""

from __future__ import annotations

import importlib
from dataclasses import asdict
from importlib import resources
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.tasks.engine import EngineKind, Trajectory, checked_batch, steps_a_row
from adaptsim_jax.tasks.pushing import model as pushing
from adaptsim_jax.tasks.pushing import planar, slide
from adaptsim_jax.tasks.pushing.model import PARAMETERS, PushOptions

STATE = 13
"""Columns of a state row: position (3) m, quaternion (4), velocity (3) m/s, turning in the bottle's
frame (3) rad/s.
"""
ROOM = 5.0
"""A bottle further from the arm's base than this, m, has been thrown by the numerics."""


class PushBatch(NamedTuple):
    """Checked arrays; samples that are not `fit: [B]` have been replaced by a harmless push."""

    params: np.ndarray  # [B, 4]
    actions: np.ndarray  # [B, 2]
    starts: np.ndarray  # [B, 2]
    fit: np.ndarray  # [B]


def checked(params: Any, actions: Any, starts: Any) -> PushBatch:
    """Shapes are the caller's fault (BadInput); values are a sample's (`fit`), since one of many
    may be bad.
    """
    given = {"params": params, "commands": actions, "initial": starts}
    rows = np.concatenate(checked_batch("pushing", given, (4, 2, 2)), 1)
    low = np.array((*pushing.PHYSICAL_LOW, 0.05, -1.0, 0.3, -0.5))
    high = np.array((*pushing.PHYSICAL_HIGH, 2.0, 1.0, 1.0, 0.5))
    fit = np.asarray(((rows >= low) & (rows <= high)).all(1))
    harmless = (0.1, 1e5, 0.5, 0.0, 0.4, 0.0, *pushing.START)
    rows = np.where(fit[:, None], rows, np.array(harmless))
    return PushBatch(rows[:, :4], rows[:, 4:6], rows[:, 6:], fit)


def finished(state: Any, batch: PushBatch) -> Trajectory:
    """`state [B, T, 13]` with a code for each sample, and finite whatever the code.

    A fallen bottle stays as it was when it had tilted too far (the MuJoCo scene lets it through the
    table after that). One without a motion stands at its start.
    """
    state = np.asarray(state)
    finite = np.isfinite(state).all((1, 2))
    fallen, state = _held_where_fallen(state)
    place = state[:, :, :3]
    with np.errstate(invalid="ignore"):
        in_room = (np.abs(place) < ROOM).all((1, 2)) & (place[:, :, 2] >= 0.0).all(1)
    code = np.where(
        finite & in_room, np.where(fallen, pushing.FALLEN, pushing.FINE), pushing.DIVERGED
    )
    return _with_codes(state, code, batch)


def sliding(place: np.ndarray, velocity: np.ndarray, batch: PushBatch) -> Trajectory:
    """The same for bottles that only slide: `place` and `velocity` `[B, T, 2]`."""
    state = np.zeros((*place.shape[:2], STATE), place.dtype)
    state[..., :2], state[..., 2], state[..., 3], state[..., 7:9] = (
        place,
        pushing.HEIGHT / 2,
        1.0,
        velocity,
    )
    finite = np.isfinite(place[:, -1]).all(1)  # a place that is not a number stays none
    return _with_codes(state, np.where(finite, pushing.FINE, pushing.DIVERGED), batch)


def _with_codes(state: np.ndarray, code: np.ndarray, batch: PushBatch) -> Trajectory:
    code = np.where(batch.fit, code, pushing.UNFIT)
    lost = np.flatnonzero((code == pushing.DIVERGED) | (code == pushing.UNFIT))
    if len(lost):
        state = state.copy()
        state[lost] = 0.0
        state[lost, :, :2], state[lost, :, 2], state[lost, :, 3] = (
            batch.starts[lost, None],
            pushing.HEIGHT / 2,
            1.0,
        )
    return Trajectory(state, code)


def _held_where_fallen(state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which bottles tilted too far `[B]`, and the states with the first such row to the end."""
    x, y = state[:, :, 4], state[:, :, 5]
    tilted = 1 - 2 * (x * x + y * y) < np.cos(
        pushing.FALLEN_TILT
    )  # the cosine of the tilt; False where it is not a number
    fallen = tilted.any(1)
    if not fallen.any():
        return fallen, state
    last = np.where(fallen, tilted.argmax(1) if state.shape[1] else 0, state.shape[1])
    good = np.minimum(np.arange(state.shape[1]), last[:, None])
    return fallen, np.take_along_axis(state, good[:, :, None], 1)


def model(options: PushOptions, dt: float, drawn: bool = False) -> Any:
    """The compiled `mujoco.MjModel` of the shipped scene, with the bottle of `options`; what is
    only seen, if `drawn`.

    BadInput where rows cannot be cut out of steps of `dt` s.
    """
    steps_a_row("pushing in MuJoCo", dt, options.row, 0.005)
    mujoco: Any = importlib.import_module("mujoco")
    text = resources.files("adaptsim_jax.tasks.pushing.engines").joinpath("scene.xml").read_text()
    spec = mujoco.MjSpec.from_string(text)
    spec.option.timestep = dt
    bottle = spec.body("bottle")
    bottle.mass, bottle.ipos, bottle.inertia = options.mass, options.com, options.inertia
    if not drawn:  # a fifth of a step's time goes into what touches nothing
        for thing in (
            spec.geom("skin"),
            spec.geom("plate"),
            spec.geom("patch"),
            *spec.lights,
            *spec.textures,
        ):
            spec.delete(thing)
    return spec.compile()


class Rest(NamedTuple):
    """The bottle standing at rest: `qpos [11]`, and the accelerations `[10]` from which solvers
    start.
    """

    qpos: np.ndarray
    warmstart: np.ndarray


def rest(m: Any) -> Rest:
    """Half a second of settling, so that a push does not begin with a fall of micrometres."""
    mujoco: Any = importlib.import_module("mujoco")
    data = mujoco.MjData(m)
    start = data.qpos.copy()
    mujoco.mj_step(m, data, round(0.5 / m.opt.timestep))
    data.qpos[:2], data.qpos[7:], data.qvel[:] = start[:2], start[7:], 0.0
    mujoco.mj_forward(m, data)
    return Rest(data.qpos.copy(), data.qacc.copy())


def controls(actions: np.ndarray, dt: float, steps: int) -> np.ndarray:
    """Accelerations `[B, steps, 3]` of the plate along forward, rise and pitch that follow the
    profile exactly.
    """
    slope = pushing.slopes(dt, steps)
    per_unit = np.stack(
        [
            actions[:, 0],
            np.full(len(actions), pushing.RISE_SPEED),
            np.full(len(actions), pushing.PITCH_RATE),
        ],
        -1,
    )
    return per_unit[:, None, :] * slope[:, None]


class PlanarSettings(NamedTuple):
    """coefficients: What calibration sets. lacking: What acts beside the declared; then it is the
    slide in two dimensions.
    """

    coefficients: planar.PlanarCoefficients = planar.DEFAULT
    lacking: slide.Lacking = slide.Lacking()


def make_planar(
    options: PushOptions, coefficients: planar.PlanarCoefficients, lacking: slide.Lacking
):
    planar.check_options(options)
    every = round(options.row / slide.ROW)

    def slid(p, a, s):
        values = asdict(lacking) | {name: p[i] for i, name in enumerate(PARAMETERS)}
        return slide.rollout(values, a, options, coefficients, s)[every::every]

    @jax.jit
    def run(params, actions, starts):
        def plain(p, a, s):
            return planar.trajectory(p, a, options, coefficients, s)

        return jax.vmap(plain if lacking == slide.Lacking() else slid)(params, actions, starts)

    def simulate(params, commands, initial):
        batch = checked(params, commands, initial)
        flat = np.asarray(run(*(jnp.asarray(a, jnp.result_type(float)) for a in batch[:3])))
        return sliding(flat[..., :2], flat[..., 2:4], batch)

    return simulate


PLANAR = EngineKind(PlanarSettings, make_planar)
