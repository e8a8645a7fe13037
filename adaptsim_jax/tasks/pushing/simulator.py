"""Which engine the push is simulated in where E is tried: in Phase 1, where actions are refined, and where pushes are corrected."""

from collections.abc import Callable

import jax

from adaptsim_jax.tasks.pushing import planar
from adaptsim_jax.tasks.pushing.config import PushingConfig
from adaptsim_jax.tasks.pushing.model import PushOptions

TWINS = {"native": planar.DEFAULT, "drake": planar.DRAKE}
POINTS = 6

Push = Callable[[jax.Array, jax.Array], jax.Array]


def make_simulator(config: PushingConfig) -> Push:
    """`push(params [4], action [2]) -> [T, 2]` m, the bottle at even times (action: speed m/s, angle rad). Pure; T is what the engine
    gives, the six observed points at least, and the last is the end."""
    if config.simulator == "planar":
        return _twin(config)
    from adaptsim_jax.tasks.pushing.engines.served import make_served

    return make_served(PushOptions(friction=config.friction, duration=config.duration), POINTS)


def make_guide(config: PushingConfig) -> Push | None:
    """A cheaper simulator to take slopes from, where there is one: the native scene's planar twin."""
    return None if config.simulator == "planar" else _twin(config)


def _twin(config: PushingConfig) -> Push:
    options, twin = PushOptions(friction=config.friction, duration=config.duration), TWINS[config.coefficients]
    return lambda params, action: planar.rollout(params, action, options, twin)
