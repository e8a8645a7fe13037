"""Atoms: every candidate effect at fixed shapes, for which it acts in proportion to an amplitude.

A jump effect (a dead zone, a delay) is not proportional to its size: its atom is the change that one size makes, per
unit of size. Several atoms of one effect at one place are its shape grid; the best of them starts the full fit.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.effects.base import Dry, Effect, Motion, Reach
from adaptsim_jax.effects.layout import Layout
from adaptsim_jax.logs.segments import Windows
from adaptsim_jax.logs.types import Atom
from adaptsim_jax.mechanisms.plant import Plant
from adaptsim_jax.sysid.forward import Model, first_angles, gather_command, mean_speed, measure, trial_command

MANY = 100  # columns of one effect (a grid of frequencies) that are worth a program of their own


@dataclass(frozen=True)
class Columns:
    """The columns of all atoms, grouped by effect. joint `[K_e]` and params `[K_e, n_params]` per effect are traced;
    counts are padded to a multiple of 8, so that programs repeat. Measurement effects come last."""

    joint: tuple[jax.Array, ...]
    params: tuple[jax.Array, ...]
    effects: tuple[Effect, ...]
    counts: tuple[int, ...] = ()
    atoms: tuple[Atom, ...] = ()

    def trim(self, groups: Sequence[np.ndarray]) -> list[np.ndarray]:
        """One group `[K_e, ...]` for each effect without its padding."""
        return [np.asarray(g)[:c] for g, c in zip(groups, self.counts, strict=True)]

    def split(self) -> tuple["Columns", list["Columns"]]:
        """Those of measurement effects; and the others in groups of much the same work, which may be computed abreast."""
        sensed = [i for i, e in enumerate(self.effects) if e.place == "measurement"]
        acting = [i for i in range(len(self.effects)) if i not in sensed]
        few = [i for i in acting if self.counts[i] < MANY]
        groups = [few, *([i] for i in acting if i not in few)]
        return self._of(sensed), [self._of(g) for g in groups if g]

    def _of(self, at: Sequence[int]) -> "Columns":
        pick = lambda z: tuple(z[i] for i in at)
        return Columns(pick(self.joint), pick(self.params), pick(self.effects), pick(self.counts))


def _flatten(c: Columns):
    return (c.joint, c.params), (c.effects, tuple(len(j) for j in c.joint))


jax.tree_util.register_pytree_node(Columns, _flatten, lambda aux, kids: Columns(kids[0], kids[1], aux[0]))


def columns_of(layout: Layout, reach: Reach, names: Sequence[str] | None = None) -> Columns:
    """Columns and atoms of all instances (or those of the named effects) at the shapes of their grids."""
    groups: dict[str, list] = {}
    wanted = [i for i in layout.instances if names is None or i.effect.name in names]
    wanted.sort(key=lambda i: i.effect.place == "measurement")
    atoms, at = [], 0
    order = list(dict.fromkeys(i.effect for i in wanted))
    for instance in wanted:
        effect = instance.effect
        for shape in effect.grid_points(reach, instance.joint):
            rows = _unit_params(effect, shape)
            groups.setdefault(effect.name, []).extend((instance.joint, row) for row in rows)
    for effect in order:
        for instance in (i for i in wanted if i.effect is effect):
            for shape in effect.grid_points(reach, instance.joint):
                size = len(_unit_params(effect, shape))
                sign = 1 if effect.jump and effect.amplitudes[0].low >= 0 else effect.amplitudes[0].sign
                atoms.append(Atom(effect.name, instance.where, dict(shape), tuple(range(at, at + size)), sign))
                at += size
    joint, params, counts = [], [], []
    for effect in order:
        rows = groups[effect.name]
        padded = rows + [rows[-1]] * (-len(rows) % 8)
        joint.append(np.array([j for j, _ in padded], np.int32))
        params.append(np.array([p for _, p in padded], float))
        counts.append(len(rows))
    return Columns(tuple(joint), tuple(params), tuple(order), tuple(counts), tuple(atoms))


def _unit_params(effect: Effect, shape: dict[str, float]) -> list[list[float]]:
    """Rows `[parameters | direction]`, one a column: off, towards each amplitude in turn; a jump at its size."""
    value = {p.name: shape.get(p.name, p.default if p.off is None else p.off) for p in effect.parameters}
    values = [value[p.name] for p in effect.parameters]
    sizes = effect.amplitudes[:1] if effect.jump else effect.amplitudes
    return [values + [1.0 if p is size else 0.0 for p in effect.parameters] for size in sizes]


def _live(windows: Windows) -> np.ndarray:
    """`[W, L]`: rows of a trial, and not the padding after a window's last."""
    return np.arange(windows.time.shape[1])[None] <= windows.time.argmax(1)[:, None]


def gravity_torque(plant: Plant, theta: np.ndarray, windows: Windows) -> np.ndarray:
    """How large gravity's torque is along the measured motion, `[N, n]` N m."""
    with jax.enable_x64(True):
        force = plant.gravity_force(jnp.asarray(theta, float), jnp.asarray(windows.motion_q[_live(windows)].T))
    return np.abs(np.asarray(force)).T


def make_reach(plant: Plant, theta: np.ndarray, windows: Windows) -> Reach:
    """What the data cover: peaks and quantiles over all trials, and inertias at the middle of travel."""
    live = _live(windows)
    q, v, u = (z[live] for z in (windows.motion_q, windows.motion_v, np.abs(windows.torque)))
    with jax.enable_x64(True):
        middle = np.median(q, 0)[:, None]
        inertia = np.asarray(jax.jit(Plant.inertia_at)(plant, theta, middle))[:, 0]  # by themselves thirty programs
    torque = np.quantile(u if np.any(u) else gravity_torque(plant, theta, windows), 0.998, axis=0)
    torque = np.maximum(torque, 0.05 * torque.max() + 1e-6)
    speed = np.maximum(np.quantile(np.abs(v), 0.9, axis=0), 0.05)
    low, high = np.quantile(q, [0.005, 0.995], axis=0)
    dt = float(np.median(windows.dt[windows.dt > 0]))
    return Reach(torque, u.max(0), speed, low, high, float(windows.time.max()), dt, inertia)


def _named(effect: Effect, row) -> tuple[dict, ...]:
    """Parameters of a column, and the direction in which its amplitude grows."""
    count = len(effect.parameters)
    shape = () if effect.place == "force" else (1, 1)  # time and lanes
    return tuple({p.name: row[k + at].reshape(shape) for k, p in enumerate(effect.parameters)} for at in (0, count))


def _change(effect: Effect, row, act):
    """How `act(p)`, an array or tuple of arrays, changes per unit of the column's amplitude."""
    p, direction = _named(effect, row)
    if not effect.jump:
        return jax.jvp(act, (p,), (direction,))[1]
    size = effect.amplitudes[0]
    off = p | {size.name: jnp.full_like(p[size.name], float(size.off or 0.0))}
    return jax.tree.map(lambda a, b: (a - b) / (p[size.name] - size.off), act(p), act(off))


def force_rows(model: Model, theta, eff, mask, windows: Windows, drive, x, columns: Columns):
    """Mean force of every force and command column over each row, N m per unit amplitude.

    One `[K_e, W, n, L]` (float32) for each effect, padding included (`Columns.trim`).
    """
    out = []
    motion = _measured_motion(windows, drive.time)
    for joint, params, effect in zip(columns.joint, columns.params, columns.effects, strict=True):
        if effect.place == "measurement":
            continue
        if effect.place == "command":
            one = _command_rows(model, eff, mask, windows, drive, effect)
        elif effect.inertia:
            one = _inertia_rows(model, drive, x, effect)
        elif effect.memory:
            one = _memory_rows(model, theta, windows, effect)
        else:
            one = _force_rows(model, theta, drive, motion, effect)
        out.append(jax.lax.map(lambda jp, f=one: f(*jp).astype(jnp.float32), (joint, params), batch_size=8))
    return tuple(out)


def _spread(force, joint, joints: int):
    """`[..., 1 or n, L, W]` to `[W, n, L]`, on its own joint."""
    if force.shape[0] == 1:
        force = force * (jnp.arange(joints) == joint)[:, None, None]
    return force.transpose(2, 0, 1)


def _measured_motion(windows: Windows, time) -> tuple[jax.Array, jax.Array]:
    """Smoothed measured angles and velocities at the windows' boundaries, `[n, L+1, W]` each.

    A model that lacks an effect bends its own path to the data; what friction or a stop would have done follows the
    motion that took place.
    """

    def one(trial, at):
        t = jnp.asarray(windows.time)[trial]
        look = jax.vmap(lambda z: jnp.interp(at, t, z), 1, 0)
        return look(jnp.asarray(windows.motion_q)[trial]), look(jnp.asarray(windows.motion_v)[trial])

    q, v = jax.vmap(one)(jnp.asarray(windows.trial), time.T)  # [W, n, L+1]
    return q.transpose(1, 2, 0), v.transpose(1, 2, 0)


def _force_rows(model: Model, theta, drive, motion, effect: Effect):
    """Trapezoid of the force at a row's two ends, under that row's command, along the measured motion.

    In float32, as what comes of it is: that is more than twice as fast, and off by the phase of what oscillates, less than
    1e-3 rad at 50 Hz after half a minute.
    """
    n = model.plant.joint_dim
    theta, drive, motion = jax.tree.map(_single, (theta, drive, motion))
    q, v = motion
    u = drive.u.transpose(1, 0, 2)
    turned = _mean_sign(v[:, :-1], v[:, 1:])
    gravity = lambda q: model.plant.gravity_force(theta, q)

    def at(p, pick, rows):
        here, speed, time = pick(q[:, rows]), pick(v[:, rows]), drive.time[rows][None]
        motion = Motion(here, speed, pick(u), time, jnp.zeros_like(here), gravity, time + drive.clock[None, None])
        answer = effect.apply(p, motion)
        return answer.force - answer.level * pick(turned) if isinstance(answer, Dry) else answer

    def one(joint, row):
        pick = (lambda z: z) if effect.scope == "base" else (lambda z: z[joint][None])

        def mean(p):
            return 0.5 * (at(p, pick, slice(None, -1)) + at(p, pick, slice(1, None)))

        return _spread(_change(effect, _single(row), mean), joint, n)

    return one


def _single(z):
    return jnp.asarray(z, jnp.float32)


def _mean_sign(before, after):
    """Mean sign of a velocity that changes linearly over a row."""
    change = after - before
    return jnp.where(
        change != 0, (jnp.abs(after) - jnp.abs(before)) / jnp.where(change != 0, change, 1.0), jnp.sign(after)
    )


def _inertia_rows(model: Model, drive, x, effect: Effect):
    n = model.plant.joint_dim
    accel = jnp.diff(x[:, n:], axis=0) / jnp.where(drive.dt > 0, drive.dt, 1.0)[:, None]

    def one(joint, row):
        extra = _change(effect, row, effect.apply)
        return _spread(-extra * accel[:, joint][None], joint, n)

    return one


def _memory_rows(model: Model, theta, windows: Windows, effect: Effect):
    """A force with memory, run along the measured motion of whole trials."""
    n = model.plant.joint_dim
    trial = lambda z: jnp.asarray(z).transpose(2, 1, 0)
    q, v, u = trial(windows.motion_q), trial(windows.motion_v), trial(windows.torque)
    v = jnp.moveaxis(mean_speed(jnp.moveaxis(v, 1, 0)), 0, 1)
    time = jnp.asarray(windows.time).T
    h = jnp.concatenate([jnp.diff(time, axis=0), jnp.zeros_like(time[:1])])
    gravity = lambda q: model.plant.gravity_force(theta, q)

    def one(joint, row):
        def run(p):
            def step(w, now):
                q, v, u, t, h = now
                answer = effect.apply(p, Motion(q, v, u, t, w, gravity))
                return answer.target + (w - answer.target) * jnp.exp(-answer.rate * h), answer.force

            return jax.lax.scan(step, jnp.zeros_like(q[0, 0]), (q[joint], v[joint], u[joint], time, h))[1]

        force = _change(effect, row, run)
        ends = force[windows.rows.T, windows.trial[None]]  # [L+1, W]
        return _spread(0.5 * (ends[:-1] + ends[1:])[None], joint, n)

    return one


def _command_rows(model: Model, eff, mask, windows: Windows, drive, effect: Effect):
    """Change of the command, per unit of size, on top of the command effects that already act."""
    t, now = trial_command(model, eff, mask, windows)

    def one(joint, row):
        change = _change(effect, row, lambda p: effect.apply(p, t, now[:, joint]))
        rows, _ = gather_command(t, change[:, None], windows, drive.dt)  # [L, 1, W]
        return _spread(rows.transpose(1, 0, 2), joint, model.plant.joint_dim)

    return one


def measured_change(model: Model, eff, mask, windows: Windows, drive, x, columns: Columns, weight):
    """Weighted change of the outputs of every measurement column `[K, W, (L+1) Y]` (float32) per unit of size."""
    n, channels = model.plant.joint_dim, weight.shape[1]
    first = first_angles(windows, x[0])
    now = measure(model, eff, mask, drive.time, x, first, 2 * n)
    out = []
    for joint, params, effect in zip(columns.joint, columns.params, columns.effects, strict=True):
        if effect.place != "measurement":
            continue

        def one(jp, effect=effect):
            joint, row = jp
            q, v = now[:, joint], now[:, n + joint]
            change = _change(effect, row, lambda p: effect.apply(p, drive.time, q, v, first[joint]))
            own = jnp.arange(n) == joint
            dq, dv = (z[:, None] * own[None, :, None] for z in change)
            dy = jnp.concatenate([dq, dv], 1)[:, :channels] * weight
            return dy.transpose(2, 0, 1).reshape(dy.shape[2], -1).astype(jnp.float32)

        out.append(jax.lax.map(one, (joint, params), batch_size=8))
    return tuple(out)
