"""Time stepping of a plant with effects: forces, dry friction by its mean over a step, memories relaxed exactly.

Any axes of a batch lie last. Effects are evaluated once for all joints and the four Runge-Kutta stages are a loop, so
the graph stays small and vectorises.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from adaptsim_jax.models.effects import Dry, Layout, Motion, Relaxation
from adaptsim_jax.models.plant import Plant, solve_mass

TOGETHER = 5  # effects that are asked about at once


@dataclass(frozen=True)
class Model:
    """A plant and the effects that may act on it."""

    plant: Plant
    layout: Layout


jax.tree_util.register_dataclass(Model, data_fields=["plant"], meta_fields=["layout"])


class Push(NamedTuple):
    """Constant additions over a row, for sensitivities: `force [n, ...]` N m, `inertia [n, ...]` kg m^2."""

    force: jax.Array
    inertia: jax.Array


def make_model(plant: Plant, effects: tuple) -> Model:
    """A model with all instances of `effects` on the plant's joints."""
    return Model(plant, Layout(tuple(effects), plant.joints))


def motion_of(model: Model, theta, q, v, u, t, memory) -> Motion:
    """What effects see at `q, v, u: [n, ...]` and `t: [...]` or a scalar; or `[2, ...]`, time and `Motion.clock`."""
    t = _lift(t, q)
    time, clock = (t[:1], t[1:]) if t.ndim == q.ndim > 1 and t.shape[0] == 2 else (t, t)
    return Motion(q, v, u, time, memory, lambda q: model.plant.gravity_force(theta, q), clock)


def relax(answer: Relaxation, w, h):
    """A memory `[n, ...]` after `h: [...]` s at constant target and rate."""
    return answer.target + (w - answer.target) * jnp.exp(-answer.rate * _lift(h, w))


def _lift(z, like):
    """A number per lane with a first axis to broadcast over joints or states; a scalar stays one."""
    z = jnp.asarray(z)
    return z[None] if 0 < z.ndim < like.ndim else z


def _later(t, h):
    """Time `t: [...]`, or time and clock `[2, ...]`, after `h: [...]` s."""
    t, h = jnp.asarray(t), jnp.asarray(h)
    return t + (h[None] if t.ndim > h.ndim > 0 else h)


class Acting(NamedTuple):
    """Sums over the effects at a state, `[n, ...]` each: smooth force, dry friction (N m), inertia (kg m^2)."""

    force: jax.Array
    level: jax.Array
    inertia: jax.Array


def acting(model: Model, theta, eff, memory, x, u, t, on=None) -> Acting:
    """What the force effects do at `x: [S, ...]`. on `[effects]`: those that are False are skipped, at no cost but the
    question, which is put to several of them at once first; all count where None."""
    n = model.plant.joint_dim
    q, v = x[:n], x[n:]
    effects = list(model.layout.placed("force"))
    memories = dict(zip((e.name for e in effects if e.memory), memory, strict=True))

    def add(total: Acting, group) -> Acting:
        for effect in group:
            p = model.layout.params(effect, eff, q.ndim - 1)
            if effect.inertia:
                total = total._replace(inertia=total.inertia + effect.apply(p))
                continue
            w = memories.get(effect.name, jnp.zeros_like(q))
            total = _where_on(model, effect, on, one, total, effect, p, w)
        return total

    def one(total: Acting, effect, p, w) -> Acting:
        answer = effect.apply(p, motion_of(model, theta, q, v, u, t, w))
        level = total.level + answer.level if isinstance(answer, Dry) else total.level
        force = answer.force if isinstance(answer, (Dry, Relaxation)) else answer
        return Acting(total.force + force, level, total.inertia)

    total = Acting(jnp.zeros_like(q), jnp.zeros_like(q), jnp.zeros_like(q))
    if on is None:
        return add(total, effects)
    for at in range(0, len(effects), TOGETHER):
        group = effects[at : at + TOGETHER]
        total = jax.lax.cond(_any_on(model, group, on), partial(add, group=group), lambda total: total, total)
    return total


def remember(model: Model, theta, eff, memory, x, u, t, h, on=None) -> tuple[jax.Array, ...]:
    """The effects' memories after `h` s at a constant state; those that are off stay as they are."""
    n = model.plant.joint_dim
    effects = [e for e in model.layout.placed("force") if e.memory]
    out = []
    for effect, w in zip(effects, memory, strict=True):
        p = model.layout.params(effect, eff, 1)

        def later(w, p, theta, x, u, t, h, effect=effect):
            return relax(effect.apply(p, motion_of(model, theta, x[:n], x[n:], u, t, w)), w, h)

        out.append(_where_on(model, effect, on, later, w, p, theta, x, u, t, h))
    return tuple(out)


def _where_on(model: Model, effect, on, change: Callable, value, *args):
    """`change(value, *args)` if `effect` is on, else `value`."""
    if on is None:
        return change(value, *args)
    return jax.lax.cond(_any_on(model, [effect], on), lambda value: change(value, *args), lambda value: value, value)


def _any_on(model: Model, effects: list, on) -> jax.Array:
    return jnp.stack([on[model.layout.effects.index(e)] for e in effects]).any()


def row_step(model: Model, theta, eff, x, memory, u, t, dt, push: Push, substeps: int, on=None, ramp=None):
    """State and memories after a row of `dt: [W]` s from `x: [S, W]`: Runge-Kutta 4, memories relaxed exactly by half a
    substep on each side of it (Strang splitting).

    on `[effects]`: as of `acting`; ramp `[U, W]` N m: how much the command rises over the row, `u` being its mean.
    """
    h = dt / substeps
    wide = _lift(h, x)
    stages = (jnp.array([0.0, 0.5, 0.5, 1.0], x.dtype), jnp.array([1.0, 2.0, 2.0, 1.0], x.dtype) / 6.0)

    def substep(carry, i):
        x, memory = carry
        now = _later(t, i * h)
        memory = remember(model, theta, eff, memory, x, u, now, 0.5 * h, on)

        rub = _if_rubbing(model, on, theta, eff, memory, x, u, now, h, push)

        def stage(inner, ab):
            slope, total = inner
            a, b = ab
            at = x + a * wide * slope
            act = acting(model, theta, eff, memory, at, u, _later(now, a * h), on)
            here = u if ramp is None else u + ((i + a) / substeps - 0.5) * ramp
            slope = model.plant.deriv(theta, at, here, act.force + rub + push.force, act.inertia + push.inertia)
            return (slope, total + b * slope), None

        (_, total), _ = jax.lax.scan(stage, (jnp.zeros_like(x), jnp.zeros_like(x)), stages)
        x = x + wide * total
        memory = remember(model, theta, eff, memory, x, u, _later(now, h), 0.5 * h, on)
        return (x, memory), None

    if substeps == 1:
        return substep((x, memory), 0.0)[0]
    return jax.lax.scan(substep, (x, memory), jnp.arange(substeps, dtype=x.dtype))[0]


def _if_rubbing(model: Model, on, theta, eff, memory, x, u, t, h, push: Push):
    """`_dry_force`, at no cost where no effect that is dry friction is on."""
    if on is None:
        return _dry_force(model, theta, eff, memory, x, u, t, h, push, on)
    n = model.plant.joint_dim
    motion = motion_of(model, theta, x[:n], x[n:], u, t, jnp.zeros_like(x[:n]))

    def is_dry(effect) -> bool:
        p = model.layout.params(effect, eff, 1)
        return not effect.inertia and isinstance(jax.eval_shape(lambda: effect.apply(p, motion)), Dry)

    dry = [e for e in model.layout.placed("force") if is_dry(e)]
    nothing = jnp.zeros_like(push.force)
    if not dry:
        return nothing
    rub = lambda: _dry_force(model, theta, eff, memory, x, u, t, h, push, on)
    return jax.lax.cond(_any_on(model, dry, on), rub, lambda: nothing)


def _dry_force(model: Model, theta, eff, memory, x, u, t, h, push: Push, on):
    """Mean force `[n, W]` of dry friction over a step of `h: [W]` s.

    Each joint moves as under constant torque: it slides, or slides and turns round, or slides until it stops and is
    then held by just the force that holds it. So joints stick without creeping whatever the step, and nothing is stiff,
    unlike with a smoothed sign. Joints act on each other through the inverse mass: two sweeps of Gauss-Seidel, from the
    forces that would stop all of them at once.
    """
    n, plant = model.plant.joint_dim, model.plant
    q, v = x[:n], x[n:]
    act = acting(model, theta, eff, memory, x, u, t, on)
    inertia = act.inertia + push.inertia
    free = plant.deriv(theta, x, u, act.force + push.force, inertia)[n:]
    mass = plant.mass(plant.constants, theta, q)
    unit = jnp.eye(n, dtype=x.dtype).reshape((n, n) + (1,) * (q.ndim - 1)) + jnp.zeros_like(q)[None]
    answer = [solve_mass(mass, inertia, unit[j]) for j in range(n)]  # acceleration per force at each joint
    wide = _lift(h, q)
    ahead = jnp.concatenate([q, _halfway(v, free, wide)])
    level = acting(model, theta, eff, memory, ahead, u, _later(t, 0.5 * h), on).level
    stop = free + v / jnp.where(wide > 0, wide, 1.0)
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
    share = jnp.where((slow > 0) & (level >= 0), jnp.minimum(share, 1.0), 1.0)  # a fit may try a negative level
    return -level * way * share + (1.0 - share) * _within(-torque, level)
