"""Simulation of stretches by a tree of joints with effects, and its linearisation along the simulated path. Stretches lie last.

A step solves for dry friction first (the force that would stop each joint within the step, within its level: Gauss and Seidel's
sweeps over the joints, as in time-stepping of rigid contact; Stewart and Trinkle, 1996) and then integrates everything else by
Runge and Kutta's fourth order under that force. So a joint that sticks does not creep, and nothing is stiff. Bristles that yield
(presliding) are a spring in the same place: a third state of each joint, their deflection, where any model has them.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.attribution.acting import Forces, Model, Values, carried, forces, with_bristles
from adaptsim_jax.mechanisms import dynamics

SWEEPS = 3  # of Gauss and Seidel over the joints


class Rows(NamedTuple):
    """What drives the rows: u [L, n, W] mean command, t [L, W] s, dt [L, W] s."""

    u: Any
    t: Any
    dt: Any


def _accelerate(model: Model, values: Values, q, v, u, t, extra):
    act = forces(model, values, q, v, u, t)
    force = act.smooth + extra
    return dynamics.acceleration(model.tree, values.inertial, q, v, force, act.inertia, values.gravity), act


def _friction(model: Model, values: Values, q, act: Forces, free, v, bent, h):
    """Dry friction [n, W] held over a step of h s from the acceleration `free` without it; bent [n, W]: deflection of bristles."""
    n = v.shape[0]
    answer = dynamics.inverse_mass(model.tree, values.inertial, q, act.inertia)  # column j: force of 1 at joint j
    level = jnp.maximum(act.level, 0.0)
    safe = jnp.where(h > 0, h, 1.0)
    own = jnp.stack([answer[j, j] for j in range(n)])

    def turn(carry, j):  # a loop: written out for each joint it takes many times as long to compile
        after, force = carry
        slide = bent[j] + safe * (after[j] - safe * own[j] * force[j])  # by the end of the step, without it
        new = jnp.clip(-slide / (act.yielding[j] + safe**2 * own[j]), -level[j], level[j])
        after = after + h[None] * answer[:, j] * (new - force[j])[None]
        return (after, force.at[j].set(new)), None

    order = jnp.tile(jnp.arange(n), SWEEPS if n > 1 else 1)
    (_, force), _ = jax.lax.scan(turn, (v + h[None] * free, jnp.zeros_like(v)), order)
    return force


def row_step(model: Model, values: Values, x, u, t, dt, extra, substeps, rough):
    """State [2n, W] (or [3n, W] with the bristles' deflection) after a row, and the mean dry friction over it [n, W]. extra [n, W]
    N m; rough: whether anything rubs."""
    n = len(extra)
    h = dt / substeps
    wide = h[None]

    def substep(i, carry):
        whole, rubbed = carry
        now = t[None] + i * wide
        x, q, v = whole[: 2 * n], whole[:n], whole[n : 2 * n]
        bent = whole[2 * n :] if len(whole) > 2 * n else jnp.zeros_like(v)
        free, act = _accelerate(model, values, q, v, u, now, extra)
        rub = jax.lax.cond(
            rough,
            lambda: _friction(model, values, q, act, free, v, bent, h),
            lambda: jnp.zeros_like(v),
        )

        def slope(x, at):
            a, _ = _accelerate(model, values, x[:n], x[n:], u, now + at, extra + rub)
            return jnp.concatenate([x[n:], a])

        def stage(carry, ab):
            k, total = carry
            k = slope(x + ab[0] * wide * k, ab[0] * wide)
            return (k, total + ab[1] * k), None

        kind = x.dtype
        weights = jnp.array([[0.0, 1.0], [0.5, 2.0], [0.5, 2.0], [1.0, 1.0]], kind) / jnp.array([[1.0, 6.0]], kind)
        (_, total), _ = jax.lax.scan(stage, (jnp.zeros_like(x), jnp.zeros_like(x)), weights)
        after = x + wide * total
        if len(whole) > 2 * n:
            after = jnp.concatenate([after, -act.yielding * rub])
        return after, rubbed + rub / substeps

    return jax.lax.fori_loop(0, substeps, substep, (x, jnp.zeros_like(x[:n])))


def command_rows(model: Model, values: Values, stamp, command, past: int, rows: int):
    """The command [L, n, W] as it reaches the joints: effects of the place `command` act on a longer piece of it."""
    u = command
    for effect in model.effects:
        if effect.place == "command" and effect.name in values.effects:
            p = {k: z[None] for k, z in values.effects[effect.name].items()}
            u = effect.apply(p, stamp[:, None, :], u)
    return u[past : past + rows]


def measure(model: Model, values: Values, time, x, u):
    """What the sensors say [L+1, 2n, W] of states x [L+1, 2n, W] at time [L+1, W] s under commands u [L, n, W]."""
    n = x.shape[1] // 2
    q, v = x[:, :n], x[:, n:]
    for effect in model.effects:
        if effect.place == "measurement" and effect.name in values.effects:
            p = {k: z[None] for k, z in values.effects[effect.name].items()}
            also = (carried(values, x, u),) if effect.carried else ()
            q, v = effect.apply(p, time[:, None, :], q, v, q[0], *also)
    return jnp.concatenate([q, v], 1)


class Path(NamedTuple):
    """x [L+1, 2n, W]; sensed [L+1, 2n, W]; rub [L, n, W] mean dry friction; u [L, n, W] command as it arrived."""

    x: Any
    sensed: Any
    rub: Any
    u: Any


@partial(jax.jit, static_argnames=("past", "bristles"))
def simulate(
    model: Model, values: Values, time, stamp, command, x0, substeps, rough, *, past: int, bristles: bool = False
) -> Path:
    """Stretches from x0 [2n, W]."""
    drive = _drive(model, values, time, stamp, command, past)
    states = len(x0)
    x0 = with_bristles(model, values, x0, drive.u[0], drive.t[0]) if bristles else x0

    def row(x, now):
        u, t, dt = now
        new, rub = row_step(model, values, x, u, t, dt, jnp.zeros_like(x[: states // 2]), substeps, rough)
        return new, (x, rub)

    last, (x, rub) = jax.lax.scan(row, x0, drive)
    x = jnp.concatenate([x, last[None]])[:, :states]
    return Path(x, measure(model, values, time, x, drive.u), rub, drive.u)


@partial(jax.jit, static_argnames=("past", "bristles"))
def linearise(
    model: Model, values: Values, time, stamp, command, x0, substeps, rough, *, past: int, bristles: bool = False
):
    """(Path, derivatives of each row's end by its start [L, 2n, 2n, W] and by a force held over the row [L, 2n, n, W]); with bristles
    3n states."""
    drive = _drive(model, values, time, stamp, command, past)
    n = len(x0) // 2
    x0 = with_bristles(model, values, x0, drive.u[0], drive.t[0]) if bristles else x0
    states, width = x0.shape
    zero = jnp.zeros((n, width), x0.dtype)
    ways = jnp.eye(states + n, dtype=x0.dtype)[:, :, None] * jnp.ones((1, 1, width), x0.dtype)

    def row(x, now):
        u, t, dt = now
        end = lambda x, extra: row_step(model, values, x, u, t, dt, extra, substeps, rough)
        along = jax.vmap(lambda a, b: jax.jvp(end, (x, zero), (a, b)), out_axes=(None, 0))
        (new, rub), (slopes, _) = along(ways[:, :states], ways[:, states:])
        return new, (x, rub, jnp.swapaxes(slopes, 0, 1))

    last, (x, rub, slopes) = jax.lax.scan(row, x0, drive)
    x = jnp.concatenate([x, last[None]])[:, : 2 * n]
    return Path(x, measure(model, values, time, x, drive.u), rub, drive.u), slopes[:, :, :states], slopes[:, :, states:]


def _drive(model, values, time, stamp, command, past) -> Rows:
    rows = len(time) - 1
    return Rows(command_rows(model, values, stamp, command, past, rows), time[:-1], jnp.diff(time, axis=0))


def respond(by_state: np.ndarray, by_force: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Change of the states [W, L+1, 2n, K] under force columns [W, L, n, K]; slopes [W, L, S, S] and [W, L, S, n] of S states, of
    which the first are angles and speeds."""
    width, rows, joints, count = force.shape
    out = np.zeros((width, rows + 1, by_state.shape[2], count))
    for k in range(rows):
        out[:, k + 1] = by_state[:, k] @ out[:, k] + by_force[:, k] @ force[:, k]
    return out[:, :, : 2 * joints]


def responded_start(by_state: np.ndarray, joints: int) -> np.ndarray:
    """Change of the states [W, L+1, 2n, 2n] with the start."""
    width, rows, states, _ = by_state.shape
    out = np.zeros((width, rows + 1, states, 2 * joints))
    out[:, 0] = np.eye(states)[:, : 2 * joints]
    for k in range(rows):
        out[:, k + 1] = by_state[:, k] @ out[:, k]
    return out[:, :, : 2 * joints]
