"""Simulation of windows with any set of effects switched on: one compiled super-model for every candidate.

All instances of the catalogue are in one program; a mask says which act. Effects are evaluated once for all joints,
the windows lie along the last axis, and the four Runge-Kutta stages are a loop, so the graph stays small and
vectorises.
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp

from adaptsim_jax.closeloop.windows import Windows
from adaptsim_jax.models.effects import Layout, Motion, Relaxation
from adaptsim_jax.models.plant import Plant


@dataclass(frozen=True)
class Model:
    """A plant and the effects that may act on it. `sign_speed: [n]` rad/s is the width of the sign of a velocity."""

    plant: Plant
    layout: Layout
    sign_speed: jax.Array


jax.tree_util.register_dataclass(Model, data_fields=["plant", "sign_speed"], meta_fields=["layout"])


class Drive(NamedTuple):
    """What drives the windows, time first and windows last: `u [L, U, W]` N m, `dt [L, W]` s, `time [L+1, W]` s, and
    the effects' memory `(w [n, W], ...)` at the start."""

    u: jax.Array
    dt: jax.Array
    time: jax.Array
    memory: tuple[jax.Array, ...]


class Push(NamedTuple):
    """Constant additions over a row, for sensitivities: `force [n, ...]` N m, `inertia [n, ...]` kg m^2."""

    force: jax.Array
    inertia: jax.Array


def make_model(plant: Plant, effects: tuple, sign_speed) -> Model:
    """A model with all instances of `effects` on the plant's joints."""
    return Model(plant, Layout(tuple(effects), plant.joints), sign_speed)


def simulate(model: Model, theta, eff, mask, windows: Windows, x0) -> tuple[jax.Array, jax.Array]:
    """Simulated measurements `[W, L+1, Y]` and states `[W, L+1, S]` from `x0: [W, S]`.

    theta: `[P]`; eff: `[E]` flat effect parameters (`Layout`); mask: `[I]`.
    """
    eff = model.layout.masked(eff, mask)
    drive = driven(model, theta, eff, mask, windows)
    x, _ = trajectory(model, theta, eff, drive, x0.T, windows.substeps)
    y = measure(model, eff, mask, drive.time, x, windows.measured.shape[-1])
    return jnp.moveaxis(y, -1, 0), jnp.moveaxis(x, -1, 0)


def driven(model: Model, theta, eff, mask, windows: Windows) -> Drive:
    """Commands as they reach the joints, and memories warmed along the measured motion."""
    time = jnp.asarray(windows.times).T
    dt = jnp.diff(time, axis=0)
    applied = trial_command(model, eff, mask, windows)
    return Drive(gather_command(applied, windows, dt), dt, time, _warm_memory(model, theta, eff, mask, windows))


def trial_command(model: Model, eff, mask, windows: Windows) -> jax.Array:
    """The trials' torque with the command effects applied, `[T, U, N]` N m."""
    u = jnp.asarray(windows.torque).transpose(1, 2, 0)
    t = jnp.asarray(windows.time).T[:, None, :]
    effects = list(model.layout.placed("command"))

    def act(u):
        for effect in effects:
            u = effect.apply(model.layout.params(effect, eff, 1), t, u)
        return u

    return jax.lax.cond(_any(model, effects, mask), act, lambda u: u, u) if effects else u


def gather_command(applied, windows: Windows, dt) -> jax.Array:
    """Mean torque over each step of each window `[L, U, W]`, exact in impulse where rows were merged or split."""
    time = jnp.asarray(windows.time).T[:, None, :]
    impulse = jnp.cumsum(applied[:-1] * jnp.diff(time, axis=0), 0)
    impulse = jnp.concatenate([jnp.zeros_like(impulse[:1]), impulse])
    rows, trial = windows.rows.T, windows.trial[None, :]
    since = jnp.asarray(windows.times).T - time[rows, 0, trial]
    at = impulse[rows, :, trial] + applied[rows, :, trial] * since[..., None]  # [L+1, W, U]
    mean = jnp.diff(at, axis=0) / jnp.where(dt > 0, dt, 1.0)[..., None]
    return jnp.swapaxes(mean, 1, 2)


def _any(model: Model, effects: list, mask):
    """Whether any instance of the effects is on: a branch that is not taken costs nothing."""
    picked = [i for i, instance in enumerate(model.layout.instances) if instance.effect in effects]
    return jnp.asarray(mask, bool)[jnp.array(picked)].any()


def _warm_memory(model: Model, theta, eff, mask, windows: Windows) -> tuple[jax.Array, ...]:
    """Memories at the windows' starts, run along the measured motion of the whole trial."""
    q = jnp.asarray(windows.motion_q).transpose(1, 2, 0)  # [T, n, N]
    v = jnp.asarray(windows.motion_v).transpose(1, 2, 0)
    u = jnp.asarray(windows.torque).transpose(1, 2, 0)
    time = jnp.asarray(windows.time).T
    first = windows.rows[:, 0]

    def run(p, effect):
        def row(w, now):
            q, v, u, t, h = now
            return _relax(effect.apply(p, _motion(model, theta, q, v, u, t, w)), w, h), w

        h = jnp.concatenate([jnp.diff(time, axis=0), jnp.zeros_like(time[:1])])
        _, w = jax.lax.scan(row, jnp.zeros_like(q[0]), (q, v, u, time, h))
        return w[first, :, windows.trial].T

    out = []
    for effect in model.layout.placed("force"):
        if effect.memory:
            p = model.layout.params(effect, eff, 1)
            zero = jnp.zeros((q.shape[1], len(first)), q.dtype)
            on = _any(model, [effect], mask)
            out.append(jax.lax.cond(on, lambda p, e=effect: run(p, e), lambda p, z=zero: z, p))
    return tuple(out)


def _motion(model: Model, theta, q, v, u, t, memory) -> Motion:
    sign_speed = jnp.asarray(model.sign_speed).reshape((-1,) + (1,) * (q.ndim - 1))
    return Motion(q, v, u, t, memory, lambda q: model.plant.gravity_force(theta, q), sign_speed)


def _relax(answer: Relaxation, w, h):
    return answer.target + (w - answer.target) * jnp.exp(-answer.rate * h)


def forces(model: Model, theta, eff, memory, x, u, t) -> tuple[jax.Array, jax.Array]:
    """Sum of the effects' forces and extra inertias, `[n, ...]` each, at `x: [S, ...]`."""
    n = model.plant.joint_dim
    q, v = x[:n], x[n:]
    force, inertia = jnp.zeros_like(q), jnp.zeros_like(q)
    memories = iter(memory)
    for effect in model.layout.placed("force"):
        p = model.layout.params(effect, eff, q.ndim - 1)
        if effect.inertia:
            inertia = inertia + effect.apply(p)
        elif effect.memory:
            force = force + effect.apply(p, _motion(model, theta, q, v, u, t, next(memories))).force
        else:
            force = force + effect.apply(p, _motion(model, theta, q, v, u, t, jnp.zeros_like(q)))
    return force, inertia


def _remember(model: Model, theta, eff, memory, x, u, t, h) -> tuple[jax.Array, ...]:
    n = model.plant.joint_dim
    effects = [e for e in model.layout.placed("force") if e.memory]
    out = []
    for effect, w in zip(effects, memory, strict=True):
        p = model.layout.params(effect, eff, 1)
        out.append(_relax(effect.apply(p, _motion(model, theta, x[:n], x[n:], u, t, w)), w, h))
    return tuple(out)


def row_step(model: Model, theta, eff, x, memory, u, t, dt, push: Push, substeps: int):
    """State and memories after a row of `dt: [W]` s from `x: [S, W]`: Runge-Kutta 4, memories relaxed exactly by half a
    substep on each side of it (Strang splitting)."""
    h = dt / substeps
    stages = (jnp.array([0.0, 0.5, 0.5, 1.0], x.dtype), jnp.array([1.0, 2.0, 2.0, 1.0], x.dtype) / 6.0)

    def substep(carry, i):
        x, memory = carry
        now = t + i * h
        memory = _remember(model, theta, eff, memory, x, u, now, 0.5 * h)

        def stage(inner, ab):
            slope, total = inner
            a, b = ab
            at = x + a * h * slope
            force, inertia = forces(model, theta, eff, memory, at, u, now + a * h)
            slope = model.plant.deriv(theta, at, u, force + push.force, inertia + push.inertia)
            return (slope, total + b * slope), None

        (_, total), _ = jax.lax.scan(stage, (jnp.zeros_like(x), jnp.zeros_like(x)), stages)
        x = x + h * total
        memory = _remember(model, theta, eff, memory, x, u, now + h, 0.5 * h)
        return (x, memory), None

    if substeps == 1:
        return substep((x, memory), 0.0)[0]
    return jax.lax.scan(substep, (x, memory), jnp.arange(substeps, dtype=x.dtype))[0]


def trajectory(model: Model, theta, eff, drive: Drive, x0, substeps: int):
    """States `[L+1, S, W]` and memories at every boundary from `x0: [S, W]`."""
    zero = jnp.zeros((model.plant.joint_dim, x0.shape[1]), x0.dtype)
    push = Push(zero, zero)

    def row(carry, now):
        u, t, dt = now
        new = row_step(model, theta, eff, *carry, u, t, dt, push, substeps)
        return new, carry

    last, seen = jax.lax.scan(row, (x0, drive.memory), (drive.u, drive.time[:-1], drive.dt))
    return jax.tree.map(lambda a, b: jnp.concatenate([a, b[None]]), seen, last)


def measure(model: Model, eff, mask, time, x, channels: int) -> jax.Array:
    """What the sensors say `[L+1, Y, W]` of states `[L+1, S, W]`; only the first `channels` outputs are kept."""
    n = model.plant.joint_dim
    effects = list(model.layout.placed("measurement"))
    y = jax.vmap(model.plant.output)(x)

    def act(y):
        q, v = y[:, :n], y[:, n:]
        for effect in effects:
            q, v = effect.apply(model.layout.params(effect, eff, 1), time[:, None, :], q, v)
        return jnp.concatenate([q, v], 1)

    y = jax.lax.cond(_any(model, effects, mask), act, lambda y: y, y) if effects else y
    return y[:, :channels]
