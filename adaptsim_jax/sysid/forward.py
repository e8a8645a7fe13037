"""Simulation of windows with any set of effects switched on: one compiled super-model for every candidate.

All instances of the catalogue are in one program; a mask says which act. Effects are evaluated once for all joints,
the windows lie along the last axis, and the four Runge-Kutta stages are a loop, so the graph stays small and
vectorises. The step itself is `mechanisms/stepping.py`'s.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from adaptsim_jax.logs.segments import Windows
from adaptsim_jax.mechanisms.stepping import Model, Push, make_model, motion_of, relax, row_step

__all__ = ["Drive", "Model", "Push", "make_model", "measure", "row_step", "simulate", "trajectory"]


class Drive(NamedTuple):
    """What drives the windows, time first and windows last: `u [L, U, W]` N m and its rise `ramp [L, U, W]` N m over
    each step, `dt [L, W]` s, `time [L+1, W]` s, `clock [W]` s, and the effects' memory `(w [n, W], ...)` at the start."""

    u: jax.Array
    ramp: jax.Array
    dt: jax.Array
    time: jax.Array
    clock: jax.Array
    memory: tuple[jax.Array, ...]

    @property
    def stamps(self) -> jax.Array:
        """Time since the trial began, and on the clock of what goes on between trials: `[L+1, 2, W]` s."""
        return jnp.stack([self.time, self.time + self.clock[None]], 1)


def simulate(model: Model, theta, eff, mask, windows: Windows, x0) -> tuple[jax.Array, jax.Array]:
    """Simulated measurements `[W, L+1, Y]` and states `[W, L+1, S]` from `x0: [W, S]`.

    theta: `[P]`; eff: `[E]` flat effect parameters (`Layout`); mask: `[I]`.
    """
    eff = model.layout.masked(eff, mask)
    drive = driven(model, theta, eff, mask, windows)
    x, _ = trajectory(model, theta, eff, mask, drive, x0.T, windows.substeps)
    y = measure(model, eff, mask, drive.time, x, first_angles(windows, x0.T), windows.measured.shape[-1])
    return jnp.moveaxis(y, -1, 0), jnp.moveaxis(x, -1, 0)


def driven(model: Model, theta, eff, mask, windows: Windows) -> Drive:
    """Commands as they reach the joints, and memories warmed along the measured motion."""
    time = jnp.asarray(windows.times).T
    dt = jnp.diff(time, axis=0)
    clock = jnp.asarray(windows.clock)[windows.trial]
    memory = _warm_memory(model, theta, eff, mask, windows)
    half, recorded = half_rows(windows)
    given = lambda: gather_command(half, recorded, windows, dt)
    changed = lambda: gather_command(half, commanded(model, eff, mask, half, recorded), windows, dt)
    effects = list(model.layout.placed("command"))
    # all of it within the question: without command effects nothing of it has a derivative
    u, ramp = jax.lax.cond(_any(model, effects, mask), changed, given) if effects else given()
    return Drive(u, ramp, dt, time, clock, memory)


def half_rows(windows: Windows) -> tuple[jax.Array, jax.Array]:
    """Times `[2 T, N]` s and the trials' recorded torque `[2 T, U, N]` N m, two half rows for each row: a late command changes
    within a row."""
    t, u = jnp.asarray(windows.time).T, jnp.asarray(windows.torque).transpose(1, 2, 0)
    middle = 0.5 * (t + jnp.concatenate([t[1:], t[-1:]]))
    return jnp.stack([t, middle], 1).reshape(-1, t.shape[1]), jnp.repeat(u, 2, axis=0)


def commanded(model: Model, eff, mask, t, u) -> jax.Array:
    """The torque `u [2 T, U, N]` N m of half rows at `t [2 T, N]` s with the command effects that act applied."""
    for effect in model.layout.placed("command"):
        act = lambda u, effect=effect: effect.apply(timeless(model.layout.params(effect, eff, 1)), t[:, None, :], u)
        u = jax.lax.cond(_any(model, [effect], mask), act, lambda u: u, u)
    return u


def trial_command(model: Model, eff, mask, windows: Windows) -> tuple[jax.Array, jax.Array]:
    """Times of half rows `[2 T, N]` s, and the trials' torque `[2 T, U, N]` N m with the command effects applied."""
    t, recorded = half_rows(windows)
    return t, commanded(model, eff, mask, t, recorded)


def timeless(p: dict) -> dict:
    """Parameters with a first axis for time."""
    return {name: value[None] for name, value in p.items()}


def gather_command(half, applied, windows: Windows, dt) -> tuple[jax.Array, jax.Array]:
    """Mean torque over each step of each window and its rise over the step, `[L, U, W]` both: exact in impulse, and, with
    torques held over half rows, in where within the step the impulse acts. half `[2 T, N]`, applied `[2 T, U, N]`."""
    time = half[:, None, :]
    impulse = jnp.cumsum(applied[:-1] * jnp.diff(time, axis=0), 0)
    impulse = jnp.concatenate([jnp.zeros_like(impulse[:1]), impulse])
    times, trial = jnp.asarray(windows.times).T, windows.trial[None, :]
    middle = times[:-1] + 0.5 * dt

    def reached(at, row):  # [., W] -> [., W, U]
        return impulse[row, :, trial] + applied[row, :, trial] * (at - half[row, trial])[..., None]

    row = jnp.asarray(windows.rows).T
    edge = jnp.where(times >= half[2 * row + 1, trial], 2 * row + 1, 2 * row)
    between = jax.vmap(lambda column, at: jnp.searchsorted(column, at, side="right") - 1, 1, 1)
    inner = jnp.clip(between(half[:, windows.trial], middle), 0, half.shape[0] - 1)
    ends, mid = reached(times, edge), reached(middle, inner)
    safe = jnp.where(dt > 0, dt, 1.0)[..., None]
    first, second = 2.0 * (mid - ends[:-1]) / safe, 2.0 * (ends[1:] - mid) / safe
    swap = lambda z: jnp.swapaxes(z, 1, 2)
    return swap(0.5 * (first + second)), swap(1.5 * (second - first))


def _any(model: Model, effects: list, mask):
    """Whether any instance of the effects is on: a branch that is not taken costs nothing."""
    picked = [i for i, instance in enumerate(model.layout.instances) if instance.effect in effects]
    return jnp.asarray(mask, bool)[jnp.array(picked)].any()


def switched_on(model: Model, mask) -> list:
    """For each effect whether any instance of it acts."""
    return [_any(model, [effect], mask) for effect in model.layout.effects]


def mean_speed(v) -> jax.Array:
    """Mean of the speeds at the two ends of each row, time first: what carries a memory over the row."""
    return jnp.concatenate([0.5 * (v[1:] + v[:-1]), v[-1:]])


def _warm_memory(model: Model, theta, eff, mask, windows: Windows) -> tuple[jax.Array, ...]:
    """Memories at the windows' starts, run along the measured motion of the whole trial."""
    q = jnp.asarray(windows.motion_q).transpose(1, 2, 0)  # [T, n, N]
    v = mean_speed(jnp.asarray(windows.motion_v).transpose(1, 2, 0))
    u = jnp.asarray(windows.torque).transpose(1, 2, 0)
    time = jnp.asarray(windows.time).T
    first = windows.rows[:, 0]

    def run(p, effect):
        def row(w, now):
            q, v, u, t, h = now
            return relax(effect.apply(p, motion_of(model, theta, q, v, u, t, w)), w, h), w

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


def trajectory(model: Model, theta, eff, mask, drive: Drive, x0, substeps):
    """States `[L+1, S, W]` and memories at every boundary from `x0: [S, W]`."""
    zero = jnp.zeros((model.plant.joint_dim, x0.shape[1]), x0.dtype)
    push = Push(zero, zero)
    on = switched_on(model, mask)

    def row(carry, now):
        (u, ramp, t, dt), (x, memory) = now, carry
        new = row_step(model, theta, eff, x, memory, u, t, dt, push, substeps, on, ramp)
        return new, carry

    last, seen = jax.lax.scan(row, (list(x0), drive.memory), (drive.u, drive.ramp, drive.stamps[:-1], drive.dt))
    x, memory = jax.tree.map(lambda a, b: jnp.concatenate([a, b[None]]), seen, last)
    return jnp.stack(x, 1), memory


def first_angles(windows: Windows, x0) -> jax.Array:
    """Angles measured at the windows' starts `[n, W]`; the simulated ones where there is no sample."""
    n = x0.shape[0] // 2
    seen, weight = (jnp.asarray(z)[:, 0, :n].T for z in (windows.measured, windows.weight))
    return jnp.where(weight > 0, seen, x0[:n])


def measure(model: Model, eff, mask, time, x, first, channels: int) -> jax.Array:
    """What the sensors say `[L+1, Y, W]` of states `[L+1, S, W]`, having said `first: [n, W]` at the start; only the
    first `channels` outputs are kept."""
    n = model.plant.joint_dim
    effects = list(model.layout.placed("measurement"))
    y = jax.vmap(model.plant.output)(x)

    def act(y):
        q, v = y[:, :n], y[:, n:]
        for effect in effects:
            p = timeless(model.layout.params(effect, eff, 1))
            q, v = effect.apply(p, time[:, None, :], q, v, first)
        return jnp.concatenate([q, v], 1)

    y = jax.lax.cond(_any(model, effects, mask), act, lambda y: y, y) if effects else y
    return y[:, :channels]
