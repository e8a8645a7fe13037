"""Which engine the push is simulated in where E is tried: in Phase 1, where actions are refined,
and where pushes are corrected.
"""

import functools
from collections.abc import Callable
from dataclasses import asdict

import jax
import jax.numpy as jnp

from adaptsim_jax.tasks.pushing import model, planar, slide
from adaptsim_jax.tasks.pushing.config import PushingConfig
from adaptsim_jax.tasks.pushing.model import PushOptions

TWINS = {"native": planar.DEFAULT, "drake": planar.DRAKE}
POINTS = 6
STEP = 0.0025  # s, of a mended slide

Push = Callable[[jax.Array, jax.Array], jax.Array]


def make_simulator(config: PushingConfig) -> Push:
    """`push(params [4], action [2]) -> [T, 2]` m, the bottle at even times (action: speed m/s,
    angle rad). Pure; T is what the engine gives, the six observed points at least, and the last is
    the end.
    """
    if config.simulator == "planar":
        return _twin(config)
    options = PushOptions(friction=config.friction, duration=config.duration)
    if config.simulator == "mjx":
        return _in_mjx(options)
    from adaptsim_jax.tasks.pushing.engines.served import make_served

    return make_served(options, POINTS)


def make_guide(config: PushingConfig) -> Push | None:
    """A cheaper simulator to take slopes from, where there is one: the MuJoCo scene's planar
    twin.
    """
    if config.simulator == "planar":
        return None
    return _twin(config)


@functools.cache
def _in_mjx(options: PushOptions) -> Push:
    """The scene in MJX, from where bottles start."""
    from adaptsim_jax.tasks.pushing.engines.mujoco import make_push

    with (
        jax.ensure_compile_time_eval()
    ):  # the model is kept, and must hold no tracers of a caller's program
        simulate = make_push(model.check_options(options), model.ELASTICITY)

    @jax.jit  # traced once, though Phase 1 pushes in many places
    def push(params, action):
        # MJX relies on rank promotion, which a strict caller may have forbidden
        with jax.numpy_rank_promotion("allow"):
            return simulate(params, action, jnp.asarray(model.START, params.dtype))[:, :2]

    return push


def _twin(config: PushingConfig) -> Push:
    options, twin = (
        PushOptions(friction=config.friction, duration=config.duration),
        TWINS[config.coefficients],
    )
    if config.mended == slide.Lacking():
        return lambda params, action: planar.rollout(params, action, options, twin)
    lacking, every = asdict(config.mended), round(options.row / slide.ROW)

    def push(params, action):
        values = lacking | {name: params[i] for i, name in enumerate(model.PARAMETERS)}
        return slide.rollout(values, action, options, twin, step=STEP)[every::every, :2]

    return push
