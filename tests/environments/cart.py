"""A mass on a rail, in the form of gymnax's environments: no MuJoCo, so that a test compiles and
trains it in seconds.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from flax import struct


@struct.dataclass
class Params:
    """kg, N s/m, N, s."""

    mass: float = 1.0
    damping: float = 0.4
    push: float = 4.0
    unused: float = 1.0
    dt: float = 0.04
    max_steps_in_episode: int = 25


class Box(NamedTuple):
    low: float = -1.0
    high: float = 1.0
    shape: tuple[int, ...] = (1,)


class State(NamedTuple):
    place: Any
    speed: Any


class Cart:
    """It begins 0.5 m off, at rest; a step is worth 1 in the middle."""

    name = "cart"
    default_params = Params()

    def __init__(self):
        self.fields = {"params.mass": (0.5, 2.0, "log"), "params.damping": (0.1, 2.0)}

    def reset(self, key, params=None): ...

    def step(self, key, state, action, params=None): ...

    def action_space(self, params):
        return Box()

    def reset_env(self, key, params):
        state = State(jnp.full((), 0.5), jnp.zeros(()))
        return self.seen(state), state

    def step_env(self, key, state, action, params):
        force = params.push * action[0] - params.damping * state.speed
        speed = state.speed + params.dt * force / params.mass
        state = State(state.place + params.dt * speed, speed)
        return self.seen(state), state, self.reward(state), jnp.zeros((), bool), {}

    def seen(self, state):
        return jnp.stack([state.place, state.speed])

    def reward(self, state):
        return jnp.exp(-10.0 * jnp.square(state.place))
