"""A trial of scooping: what it depends on (its context), what is done in it, what comes of it, and
what a camera sees of it.

Given its context a trial is a function, in Drake as in ours, so that all methods can be scored on
the same luck.

The engine's derivatives are exact, but of use only while a motion is not chaotic. With the blade's
edge under a flat bottom every contact multiplies the derivative. At the end of a trial it may be
1e10 times what a change of any size that matters does (`experiments/scooping_gradient.py`). So
`smoothed` spreads the inputs, and differentiates the chance of success by the score-function
estimator, which needs outcomes alone.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from adaptsim_jax.tasks.scooping import hydro, model
from adaptsim_jax.tasks.scooping.config import ScoopingTrajectory
from adaptsim_jax.tasks.scooping.model import Numerics, ScoopOptions

POINTS = len(model.OBSERVED_AT)
PLACES = np.array([0.04, 0.03])
"""Half the box that pieces are placed in, 8 by 6 cm about its middle, m."""
CONTEXT = 5
"""Numbers of a trial's context: the piece's place `[2]` m, all that the policy sees of it; then
what no one knows beforehand: errors of pitch and rate in [-1, 1], and a number in [0, 1) that the
camera's noise is drawn with.
"""
_SPAN = 0.15  # m: places seen are divided by it


def draw_context(key: Array) -> Array:
    """A context `[5]` of a trial; see `CONTEXT`."""
    u = jax.random.uniform(key, (CONTEXT,))
    place = (2.0 * u[:2] - 1.0) * jnp.asarray(PLACES, u.dtype)
    return jnp.concatenate([place, 2.0 * u[2:4] - 1.0, u[4:]])


def place_input(context: Array) -> Array:
    """What the policy sees of `contexts [..., >= 2]`: the place, in [-1, 1]."""
    lead = (1,) * (context.ndim - 1)
    return context[..., :2] / jnp.asarray(PLACES, context.dtype).reshape(*lead, 2)


def executed(action: Array, context: Array, options: ScoopOptions) -> Array:
    """What is done when `action [3]` in [-1, 1] is asked for: (pitch rad, rate rad/s, distance m),
    with the context's errors.
    """
    errors = jnp.concatenate([context[2:4], jnp.zeros(1, context.dtype)])
    return model.physical_action(action) + errors * jnp.asarray(options.noise, action.dtype)


def make_trial(options: ScoopOptions, numerics: Numerics) -> Callable[[Array, Array, Array], Array]:
    """`trial(params [4], action [3], context [5]) -> outcome [9, 2]` in the engine: eight places m
    from where the piece lay, and (success, height over the tip's plane m). Not-a-number, success 0,
    where the engine reports a fault.
    """
    rows = hydro.observed_rows(numerics)

    def trial(params, action, context):
        out = hydro.rollout(params, executed(action, context, options), options, numerics)
        x = out.piece[rows, 0]
        places = jnp.stack([x, jnp.zeros_like(x)], -1)
        found = jnp.concatenate([places, jnp.stack([out.success, out.above])[None]])
        return jnp.where((out.code == model.DIVERGED) | (out.code == model.UNFIT), jnp.nan, found)

    return trial


@functools.cache
def make_mjx_trial(options: ScoopOptions) -> Callable[[Array, Array, Array], Array]:
    """The same in the MuJoCo scene, in MJX. Not-a-number for pieces and actions that the scene is
    not made for, too.
    """
    from adaptsim_jax.tasks.scooping.engines.mujoco import make_scoop
    from adaptsim_jax.tasks.scooping.model import ROW

    with (
        jax.ensure_compile_time_eval()
    ):  # the model is kept, and must hold no tracers of a caller's program
        scoop = make_scoop(options)
    rows = np.maximum(np.round(np.array(model.OBSERVED_AT) / ROW).astype(int) - 1, 0)

    def trial(params, action, context):
        done = executed(action, context, options)
        # MJX relies on rank promotion, which a strict caller may have forbidden
        with jax.numpy_rank_promotion("allow"):
            q = scoop(params, done)
        x = q[rows, 0].at[0].set(0.0)  # seen before it moves
        gap = q[-1, :2] - q[-1, 3:5]
        c, s = jnp.cos(q[-1, 5]), jnp.sin(q[-1, 5])
        dx, dz = gap
        ahead, above = c * dx - s * dz, s * dx + c * dz  # in the tip's frame
        end = jnp.stack([model.on_blade(ahead, above), above])
        found = jnp.concatenate([jnp.stack([x, jnp.zeros_like(x)], -1), end[None]])
        lasts = (
            jnp.all(jnp.isfinite(q))
            & jnp.all(jnp.abs(q[:, 0]) < 2.0)
            & jnp.all(jnp.abs(q[:, 1]) < 1.0)
        )
        inside = jnp.all(
            (params >= jnp.array(model.PHYSICAL_LOW)) & (params <= jnp.array(model.PHYSICAL_HIGH))
        )
        return jnp.where(lasts & inside, found, jnp.nan)

    return trial


def success(outcome: Array) -> Array:
    """`[...]`: 1 where the piece of `outcome [..., 9, 2]` lies on the spatula at the end; 0 where
    it is not finite.
    """
    return jnp.where(outcome[..., -1, 0] > 0.5, 1.0, 0.0)


def camera_view(points: Array, context: Array, camera: tuple[float, ...]) -> Array:
    """`points [8, 2]` m as the camera sees them: blurred ahead, and noisy (paper, appendix). The
    context seeds the noise.
    """
    seed = jnp.floor(context[4] * 2.0**23).astype(jnp.uint32)
    noise = jax.random.normal(jax.random.key(seed), points.shape, points.dtype)
    return points + jnp.array([[camera[0], 0.0]], points.dtype) + camera[1] * noise


def measured(
    contexts: Array,
    outcomes: Array,
    camera: tuple[float, ...],
    tested: Array | None = None,
) -> ScoopingTrajectory:
    """The trajectory of `N` trials in `contexts [N, 5]` from their `outcomes [N, 9, 2]`, of any
    engine.
    """
    points = jax.vmap(lambda o, c: camera_view(o[:-1], c, camera))(outcomes, contexts)
    lies = success(outcomes)
    return ScoopingTrajectory(points, lies, lies.mean() if tested is None else tested)


def observed(trajectory: ScoopingTrajectory) -> Array:
    """`[obs_dim]`: places along and across the table in units of 15 cm; far out they are held at
    4.
    """
    shown = trajectory.points / _SPAN
    return jnp.clip(jnp.where(jnp.isfinite(shown), shown, 4.0), -4.0, 4.0).reshape(-1)


def test_contexts(count: int) -> np.ndarray:
    """`[count, 5]`: places and errors spread evenly, the same for every policy (a lattice of
    irrational steps).
    """
    row = np.arange(count)[:, None] + 0.5
    u = row * np.array([0.8566749, 0.7338919, 0.6287067, 0.5385973, 0.4614027]) % 1.0
    places = (2 * u[:, :2] - 1) * PLACES
    return np.concatenate([places, 2 * u[:, 2:4] - 1, u[:, 4:]], 1).astype(np.float32)


test_contexts.__test__ = False  # type: ignore[attr-defined]  # for pytest, which collects by name


RANGES = (0.15, float(np.log(50.0)), 0.01, float(np.radians(8.0)), 0.4, 0.015)
"""Omega's and the actions' ranges: friction, log modulus, height m, pitch rad, rate rad/s, distance
m.
"""


class Smoothed(NamedTuple):
    """chance `[]` of success over the spread of inputs; gradient `[6]` of it and its standard error
    `[6]`, by the inputs' ranges: friction, log modulus, height, pitch, rate, distance.
    """

    chance: Array
    gradient: Array
    error: Array


def scaled(params: Array, action: Array) -> Array:
    """`[6]`: the inputs of `Smoothed`, in shares of Omega's and the actions' ranges."""
    return jnp.stack([params[0], jnp.log(params[1]), params[3], *action]) / jnp.asarray(
        RANGES, params.dtype
    )


def unscaled(z: Array, shape: Array) -> tuple[Array, Array]:
    """`(params [4], action [3])` of `z [6]`, the inverse of `scaled`; pitch and distance stay above
    0.
    """
    v = z * jnp.asarray(RANGES, z.dtype)
    minimum = jnp.asarray([1e-3, -1.0, 1e-3], z.dtype)
    return jnp.stack([v[0], jnp.exp(v[1]), shape, v[2]]), jnp.maximum(v[3:], minimum)


def smoothed(
    key: Array,
    params: Array,
    action: Array,
    *,
    spread: float = 0.1,
    pairs: int = 256,
    options: ScoopOptions = ScoopOptions(),  # noqa: B008
    numerics: Numerics = Numerics(),  # noqa: B008
) -> Smoothed:
    """Chance of success with normal errors of `spread` (a share of the ranges) on all inputs, and
    its gradient, from `pairs` of trials on both sides: `E[success(z + s n) n] / s`. Pure; jit it.
    """
    z = scaled(params, action)
    n = jax.random.normal(key, (pairs, len(RANGES)), z.dtype)

    def won(at):
        return hydro.rollout(*unscaled(at, params[2]), options, numerics).success

    up = jax.vmap(won)(z[None] + spread * n)
    down = jax.vmap(won)(z[None] - spread * n)
    each = (up - down)[:, None] * n / (2 * spread)
    return Smoothed((up + down).mean() / 2, each.mean(0), each.std(0) / np.sqrt(pairs))
