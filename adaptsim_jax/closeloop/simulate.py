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
from adaptsim_jax.models.effects import Dry, Layout, Motion, Relaxation
from adaptsim_jax.models.plant import Plant, solve_mass


@dataclass(frozen=True)
class Model:
    """A plant and the effects that may act on it."""

    plant: Plant
    layout: Layout


jax.tree_util.register_dataclass(Model, data_fields=["plant"], meta_fields=["layout"])


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


def make_model(plant: Plant, effects: tuple) -> Model:
    """A model with all instances of `effects` on the plant's joints."""
    return Model(plant, Layout(tuple(effects), plant.joints))


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
    return Motion(q, v, u, t, memory, lambda q: model.plant.gravity_force(theta, q))


def _relax(answer: Relaxation, w, h):
    return answer.target + (w - answer.target) * jnp.exp(-answer.rate * h)


class Acting(NamedTuple):
    """Sums over the effects at a state, `[n, ...]` each: smooth force, dry friction (N m), inertia (kg m^2)."""

    force: jax.Array
    level: jax.Array
    inertia: jax.Array


def acting(model: Model, theta, eff, memory, x, u, t) -> Acting:
    """What the force effects do at `x: [S, ...]`."""
    n = model.plant.joint_dim
    q, v = x[:n], x[n:]
    force, level, inertia = jnp.zeros_like(q), jnp.zeros_like(q), jnp.zeros_like(q)
    memories = iter(memory)
    for effect in model.layout.placed("force"):
        p = model.layout.params(effect, eff, q.ndim - 1)
        if effect.inertia:
            inertia = inertia + effect.apply(p)
            continue
        w = next(memories) if effect.memory else jnp.zeros_like(q)
        answer = effect.apply(p, _motion(model, theta, q, v, u, t, w))
        if isinstance(answer, Dry):
            level = level + answer.level
        force = force + (answer.force if isinstance(answer, (Dry, Relaxation)) else answer)
    return Acting(force, level, inertia)


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

        rub = _dry_force(model, theta, eff, memory, x, u, now, h, push)

        def stage(inner, ab):
            slope, total = inner
            a, b = ab
            at = x + a * h * slope
            act = acting(model, theta, eff, memory, at, u, now + a * h)
            slope = model.plant.deriv(theta, at, u, act.force + rub + push.force, act.inertia + push.inertia)
            return (slope, total + b * slope), None

        (_, total), _ = jax.lax.scan(stage, (jnp.zeros_like(x), jnp.zeros_like(x)), stages)
        x = x + h * total
        memory = _remember(model, theta, eff, memory, x, u, now + h, 0.5 * h)
        return (x, memory), None

    if substeps == 1:
        return substep((x, memory), 0.0)[0]
    return jax.lax.scan(substep, (x, memory), jnp.arange(substeps, dtype=x.dtype))[0]


def _dry_force(model: Model, theta, eff, memory, x, u, t, h, push: Push):
    """Mean force `[n, W]` of dry friction over a step of `h: [W]` s.

    Each joint moves as under constant torque: it slides, or slides and turns round, or slides until it stops and is
    then held by just the force that holds it. So joints stick without creeping whatever the step, and nothing is stiff,
    unlike with a smoothed sign. Joints act on each other through the inverse mass: two sweeps of Gauss-Seidel, from the
    forces that would stop all of them at once.
    """
    n, plant = model.plant.joint_dim, model.plant
    q, v = x[:n], x[n:]
    act = acting(model, theta, eff, memory, x, u, t)
    inertia = act.inertia + push.inertia
    free = plant.deriv(theta, x, u, act.force + push.force, inertia)[n:]
    mass = plant.mass(plant.constants, theta, q)
    unit = jnp.eye(n, dtype=x.dtype)[:, :, None] + jnp.zeros_like(q)
    answer = [solve_mass(mass, inertia, unit[j]) for j in range(n)]  # acceleration per force at each joint
    ahead = jnp.concatenate([q, _halfway(v, free, h)])
    level = acting(model, theta, eff, memory, ahead, u, t + 0.5 * h).level
    level = jnp.where(level >= 0, level, 0.0)
    stop = free + v / jnp.where(h > 0, h, 1.0)
    hold = -(jnp.einsum("ij...,j...->i...", mass, stop) + inertia * stop)
    force = [_within(hold[j], level[j]) for j in range(n)]
    for j in [*range(n), *range(n)]:
        others = sum((answer[k][j] * force[k] for k in range(n) if k != j), jnp.zeros_like(free[j]))
        force[j] = _mean_friction(v[j], (free[j] + others) / answer[j][j], level[j], 1.0 / answer[j][j], h)
    return jnp.stack(force)


def _halfway(v, accel, h):
    """Speed half a step on, zero if it would have turned."""
    ahead = v + 0.5 * h * accel
    return jnp.where(ahead * v > 0, ahead, 0.0)


def _within(force, level):
    """`force` limited to `level`, with the right slope where the level is zero."""
    return level * jnp.clip(force / jnp.maximum(level, 1e-9), -1.0, 1.0)


def _mean_friction(v, torque, level, inertia, h):
    """Mean friction on one joint that moves at `v` under a constant other `torque`: sliding for a part of the step,
    then holding, or sliding the other way."""
    way = jnp.sign(v)
    slow = level - way * torque  # what brakes it
    share = jnp.abs(v) * inertia / (jnp.where(h > 0, h, 1.0) * jnp.maximum(slow, 1e-9))
    share = jnp.where(slow > 0, jnp.minimum(share, 1.0), 1.0)
    return -level * way * share + (1.0 - share) * _within(-torque, level)


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
