"""Actuators of a mechanism: what a command makes of a joint's position and speed.

All kinds are one law, MuJoCo's with affine bias: with `length = gear q` and `speed = gear v`,

    force = gain ctrl + offset - kp length - kv speed        the joint gets gear * (force within forcerange)

A motor has gain 1, kp = kv = 0; a position servo gain = kp, a velocity servo gain = kv; a dcmotor (volts) gain = K / R and
kv = K^2 / R; `general` is any other. Ranges are nan where there is none.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

Array = Any

KINDS = ("motor", "position", "velocity", "general", "dcmotor")
NO_RANGE = (float("nan"), float("nan"))


@dataclass(frozen=True)
class Actuator:
    """One actuator. `joint` is an index into the tree; `delay` and `lag` (a first-order filter of the command) in s; more: other
    joints that it pulls by a tendon, each with its own gear."""

    name: str
    joint: int
    kind: str
    gear: float = 1.0
    gain: float = 1.0
    offset: float = 0.0
    kp: float = 0.0
    kv: float = 0.0
    forcerange: tuple[float, float] = NO_RANGE
    ctrlrange: tuple[float, float] = NO_RANGE
    delay: float = 0.0
    lag: float = 0.0
    more: tuple[tuple[int, float], ...] = ()


@dataclass(frozen=True)
class ActuatorArrays:
    """The same as arrays `[k]`, ranges `[k, 2]`; numbers may be traced and carry lanes behind."""

    joint: tuple[int, ...]
    kinds: tuple[str, ...]
    gear: Array
    gain: Array
    offset: Array
    kp: Array
    kv: Array
    forcerange: Array
    ctrlrange: Array


_NUMBERS = ("gear", "gain", "offset", "kp", "kv")
_RANGES = ("forcerange", "ctrlrange")
jax.tree_util.register_dataclass(ActuatorArrays, data_fields=[*_NUMBERS, *_RANGES], meta_fields=["joint", "kinds"])


def actuator_arrays(actuators: Sequence[Actuator]) -> ActuatorArrays:
    numbers = {name: np.array([getattr(a, name) for a in actuators], float) for name in _NUMBERS}
    ranges = {name: np.array([getattr(a, name) for a in actuators], float).reshape(-1, 2) for name in _RANGES}
    return ActuatorArrays(tuple(a.joint for a in actuators), tuple(a.kind for a in actuators), **numbers, **ranges)


def actuator_force(actuators: ActuatorArrays, n: int, ctrl: Array, q: Array, v: Array) -> jax.Array:
    """`[n, ...]`, on the joints, of the commands `ctrl: [k, ...]` at `q, v: [n, ...]`; delay and lag are the caller's."""
    q, v, ctrl = jnp.asarray(q), jnp.asarray(v), jnp.asarray(ctrl)
    shape = jnp.broadcast_shapes(ctrl.shape[1:], q.shape[1:], v.shape[1:])
    out = [jnp.zeros(shape, q.dtype) for _ in range(n)]
    for k, i in enumerate(actuators.joint):
        gear, gain, offset, kp, kv = (jnp.asarray(getattr(actuators, name)[k], q.dtype) for name in _NUMBERS)
        command = _within(ctrl[k], actuators.ctrlrange[k])
        force = gain * command + offset - kp * (gear * q[i]) - kv * (gear * v[i])
        out[i] = out[i] + gear * _within(force, actuators.forcerange[k])
    return jnp.stack(out)


def _within(x: jax.Array, limits: Any) -> jax.Array:
    low, high = jnp.asarray(limits, x.dtype)
    return jnp.minimum(jnp.where(jnp.isnan(high), x, high), jnp.maximum(jnp.where(jnp.isnan(low), x, low), x))
