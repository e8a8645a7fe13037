"""A controller in the loop with a model and all its effects: command, force and measurement
effects, row by row.

A law sees what the sensors say and its own past commands, decides a torque, and holds it for a row.
Command and measurement effects are functions of whole sequences. Here they get the last rows only,
as many as they remember.
"""

from collections.abc import Callable
from functools import wraps
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.effects.base import Effect
from adaptsim_jax.mechanisms.stepping import Instant, PlantModel, Sample, row_step

Law = Callable[
    [jax.Array, jax.Array, jax.Array], jax.Array
]  # (measured [S], past [H, U], t []) -> torque [U] N m
LONGEST = 40  # rows that a sensor or actuator is taken to remember at most


def broadcasts(function):
    """Effects and plants broadcast over ranks by design: allow it inside, however strict the caller
    is.
    """

    @wraps(function)
    def inside(*args, **kwargs):
        with jax.numpy_rank_promotion("allow"):
            return function(*args, **kwargs)

    return inside


class Loop(NamedTuple):
    """What happened: state `[T, S]`, measured `[T, S]`, command `[T, U]` N m at the start of each
    row.
    """

    state: jax.Array
    measured: jax.Array
    command: jax.Array


class Course(NamedTuple):
    """How long a loop runs: `rows` of `dt` s, and the rows of the past that effects and law see
    (`history`, by `history_rows`).
    """

    rows: int
    dt: float
    history: int


@broadcasts
def run_loop(sample: Sample, law: Law, start, course: Course) -> Loop:
    """Run `law` from `start: [S]`. Before the start nothing was commanded and nothing moved."""
    model, eff, dt, history = sample.model, sample.eff, course.dt, course.history
    n = model.plant.joint_dim
    start = jnp.asarray(start)
    memory = tuple(jnp.zeros((n, 1), start.dtype) for e in model.layout.placed("force") if e.memory)
    step = jnp.full((1,), dt, start.dtype)

    def row(carry, k):
        x, memory, past, states, readings = carry
        t = k * dt
        states = jnp.concatenate([states[1:], x[None]])
        y = sensed(model, eff, states, readings[1], dt)
        readings = jnp.concatenate([readings[1:], y[None, :n]])
        u = law(y, past, t)
        past = jnp.concatenate([past[1:], u[None]])
        applied = arrived(model, eff, past, dt)
        at = Instant(x[:, None], memory, applied[:, None], t[None])
        new, memory = row_step(sample, at, step)
        return (jnp.concatenate(new), memory, past, states, readings), Loop(x, y, u)

    past = jnp.zeros((history, model.plant.command_dim), start.dtype)
    states = jnp.broadcast_to(start, (history, *start.shape))
    first = sensed(model, eff, states, start[:n], dt)[:n]
    readings = jnp.broadcast_to(first, (history + 1, n))
    carry = (start, memory, past, states, readings)
    return jax.lax.scan(row, carry, jnp.arange(course.rows, dtype=start.dtype))[1]


@broadcasts
def arrived(model: PlantModel, eff, past, dt: float) -> jax.Array:
    """Torque `[U]` that reaches the joints in the row of the last of `past: [H, U]` commands."""
    u = jnp.concatenate([past, past[-1:]])[:, :, None]
    t = dt * jnp.arange(u.shape[0], dtype=u.dtype)[:, None, None]
    for effect in model.layout.placed("command"):
        u = effect.apply({k: v[None] for k, v in model.layout.params(effect, eff, 1).items()}, t, u)
    return u[-2, :, 0]


@broadcasts
def sensed(model: PlantModel, eff, states, first, dt: float) -> jax.Array:
    """What the sensors say `[S]` of the last of `seen: [H, S]` states, having said angles `first:
    [n]` at the first.
    """
    n = model.plant.joint_dim
    q, v = states[:, :n, None], states[:, n:, None]
    t = dt * jnp.arange(states.shape[0], dtype=states.dtype)[:, None, None]
    for effect in model.layout.placed("measurement"):
        q, v = effect.apply(model.layout.params(effect, eff, 1), t, q, v, first[:, None])
    return jnp.concatenate([q[-1, :, 0], v[-1, :, 0]])


def history_rows(model: PlantModel, eff: np.ndarray, dt: float) -> int:
    """Rows of the past that command and measurement effects depend on at the largest parameters
    `eff: [E]`.
    """
    rows = [np.asarray(response(model, e, eff, dt)) for e in model.layout.placed("command")]
    sizes = [np.abs(r) for r in rows]
    lengths = [int(np.flatnonzero(s.max(1) > 2e-3)[-1]) + 2 for s in sizes if s.any()]
    longest = max(lengths, default=2)
    remembers = any(e.jump for e in model.layout.placed("measurement"))
    return min(LONGEST, max(longest, LONGEST if remembers else 2))


@broadcasts
def response(model: PlantModel, effect: Effect, eff, dt: float) -> jax.Array:
    """Torque per unit `[LONGEST, U]` in each row after a command of one row, large enough to pass
    any dead zone.
    """
    size = 1e3
    t = dt * jnp.arange(LONGEST + 1, dtype=jnp.float32)[:, None, None]
    pulse = jnp.zeros((LONGEST + 1, model.plant.command_dim, 1)).at[1].set(size)
    p = {
        k: v[None] for k, v in model.layout.params(effect, jnp.asarray(eff, jnp.float32), 1).items()
    }
    return (effect.apply(p, t, pulse) - effect.apply(p, t, 0.0 * pulse))[1:, :, 0] / size


@broadcasts
def group_delay(model: PlantModel, eff, dt: float) -> jax.Array:
    """Time `[]` s by which commands arrive late: the centre of the response to one row's command,
    the later joint's.
    """
    total = jnp.zeros(model.plant.command_dim)
    for effect in model.layout.placed("command"):
        if effect.jump:
            out = jnp.abs(response(model, effect, eff, dt))
            rows = jnp.arange(out.shape[0], dtype=out.dtype)[:, None]
            total = total + dt * jnp.sum(rows * out, 0) / jnp.maximum(jnp.sum(out, 0), 1e-9)
    return jnp.max(total)
