"""Time stepping of a plant with effects: forces, dry friction by its mean over a step, memories
relaxed exactly.

Any axes of a batch lie last. Effects are evaluated once for all joints and the four Runge-Kutta
stages are a loop, so the graph stays small and vectorises.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from adaptsim_jax.effects.base import Dry, Effect, Motion, Relaxation
from adaptsim_jax.effects.layout import Layout
from adaptsim_jax.mechanisms.dry_friction import mean_friction, typical_speed, within
from adaptsim_jax.mechanisms.plant import Plant, solve_mass

Sum = Any  # an array `[n, ...]`, or None


@dataclass(frozen=True)
class PlantModel:
    """A plant and the effects that may act on it."""

    plant: Plant
    layout: Layout


jax.tree_util.register_dataclass(PlantModel, data_fields=["plant"], meta_fields=["layout"])


def make_model(plant: Plant, effects: tuple) -> PlantModel:
    """A model with all instances of `effects` on the plant's joints."""
    return PlantModel(plant, Layout(tuple(effects), plant.joints))


class Sample(NamedTuple):
    """A model with its numbers: `theta [P]` of the plant, `eff [E]` of the effects (`Layout`)."""

    model: PlantModel
    theta: Any
    eff: Any

    def params(self, effect: Effect, trailing: int) -> dict[str, jax.Array]:
        """`{name: [n, 1, ...]}` of one effect, with `trailing` axes to broadcast over."""
        return self.model.layout.params(effect, self.eff, trailing)


class Instant(NamedTuple):
    """Where a mechanism is.

    - `x`: Its state, S times `[W]` or `[S, W]`.
    - `memory`: Of effects that have one.
    - `u [W]`: The torque, N m.
    - `t`: The time, `[W]` s or a scalar.
    """

    x: Any
    memory: tuple
    u: Any
    t: Any


def motion_of(sample: Sample, at: Instant, memory) -> Motion:
    """What an effect with this memory `[n, ...]` sees."""
    n, x = sample.model.plant.joint_dim, jnp.stack(at.x)
    q = x[:n]

    def gravity(q):
        return sample.model.plant.gravity_force(sample.theta, q)

    return Motion(q, x[n:], at.u, _lift(at.t, q), memory, gravity)


def relax(answer: Relaxation, w, h):
    """A memory `[n, ...]` after `h: [...]` s at constant target and rate."""
    return answer.target + (w - answer.target) * jnp.exp(-answer.rate * _lift(h, w))


def _lift(z, like):
    """A number per lane with a first axis to broadcast over joints or states; a scalar stays
    one.
    """
    z = jnp.asarray(z)
    if 0 < z.ndim < like.ndim:
        return z[None]
    return z


class ActingSums(NamedTuple):
    """Sums over the effects at a state, `[n, ...]` each; None for what was not asked for.

    - `force`: Smooth force, N m.
    - `level`: Of dry friction, N m.
    - `inertia`: What effects add, kg m^2.
    """

    force: Sum
    level: Sum
    inertia: Sum


PUSHING = ("force", "inertia")


def acting(
    sample: Sample,
    at: Instant,
    effects: list[Effect] | None = None,
    only: tuple[str, ...] = ActingSums._fields,
) -> ActingSums:
    """What the force effects do at an instant.

    Args:
        sample: model and parameters.
        at: its state is `[S, ...]` or S times `[...]`.
        effects: others are left out, none where None.
        only: fields that are wanted.
    """
    every = list(sample.model.layout.placed("force"))
    memories = dict(zip((e.name for e in every if e.memory), at.memory, strict=True))
    effects = every if effects is None else effects
    at = at._replace(x=[jnp.asarray(z) for z in at.x])
    first = at.x[0]
    zero = jnp.zeros((sample.model.plant.joint_dim, *first.shape), first.dtype)
    total = ActingSums(*(zero if field in only else None for field in ActingSums._fields))
    if "inertia" in only:  # numbers that no state changes: zero where the effect is off
        own = [e.apply(sample.params(e, first.ndim)) for e in effects if e.inertia]
        total = total._replace(inertia=sum(own, total.inertia))
    for effect in (e for e in effects if not e.inertia):
        motion = motion_of(sample, at, memories.get(effect.name, zero))
        answer = effect.apply(sample.params(effect, first.ndim), motion)
        fields = {"force": answer.force if isinstance(answer, (Dry, Relaxation)) else answer}
        if isinstance(answer, Dry):
            fields |= {"level": answer.level}
        total = total._replace(
            **{field: getattr(total, field) + fields[field] for field in fields if field in only}
        )
    return total


def remember(sample: Sample, at: Instant, h) -> tuple[jax.Array, ...]:
    """The effects' memories after `h` s at a constant state."""
    effects = [e for e in sample.model.layout.placed("force") if e.memory]
    out = []
    for effect, w in zip(effects, at.memory, strict=True):
        motion = motion_of(sample, at, w)
        out.append(relax(effect.apply(sample.params(effect, 1), motion), w, h))
    return tuple(out)


def row_step(sample: Sample, at: Instant, h) -> tuple[list, tuple[jax.Array, ...]]:
    """States and memories after a row of `h: [W]` s.

    Runge-Kutta 4, memories relaxed exactly by half a row on each side of it (Strang splitting). A
    state at a time, S times `[W]`, since stacking them costs more than the dynamics do.
    """
    plant = sample.model.plant
    kind = jnp.result_type(at.x[0])
    stages = (jnp.array([0.0, 0.5, 0.5, 1.0], kind), jnp.array([1.0, 2.0, 2.0, 1.0], kind) / 6.0)
    x = list(at.x)
    by = _by_kind(sample, at)
    at = at._replace(memory=remember(sample, at, 0.5 * h))
    rub = rise = jnp.zeros((plant.joint_dim, *x[0].shape), kind)
    if by.dry:
        rub, rise = _dry_force(sample, at, h, by)

    def stage(inner, ab):
        slope, total = inner
        a, b = ab
        here = [z + a * h * d for z, d in zip(x, slope, strict=True)]
        act = acting(sample, at._replace(x=here, t=at.t + a * h), by.smooth, PUSHING)
        force = act.force + (rub + (a - 0.5) * rise)
        slope = plant.rates(sample.theta, here, at.u, force, act.inertia)
        return (slope, [t + b * d for t, d in zip(total, slope, strict=True)]), None

    zero = [jnp.zeros_like(z) for z in x]
    (_, total), _ = jax.lax.scan(stage, (zero, zero), stages)
    end = [z + h * t for z, t in zip(x, total, strict=True)]
    return end, remember(sample, at._replace(x=end, t=at.t + h), 0.5 * h)


class _ByKind(NamedTuple):
    """Force effects that push smoothly or add inertia, and those that rub dry (some do both)."""

    smooth: list[Effect]
    dry: list[Effect]


def _by_kind(sample: Sample, at: Instant) -> _ByKind:
    smooth, dry = [], []

    def answer(effect):
        motion = motion_of(sample, at, jnp.zeros_like(jnp.stack(at.x)[: len(at.x) // 2]))
        response = effect.apply(sample.params(effect, 1), motion)
        rubs = isinstance(response, Dry)
        dry.extend([effect] if rubs else [])
        smooth.extend(
            [] if rubs and isinstance(response.force, float) and response.force == 0.0 else [effect]
        )

    for effect in sample.model.layout.placed("force"):
        if effect.inertia:
            smooth.append(effect)
        else:
            jax.eval_shape(lambda effect=effect: answer(effect))
    return _ByKind(smooth, dry)


def _dry_force(sample: Sample, at: Instant, h, by: _ByKind) -> tuple[jax.Array, jax.Array]:
    """Mean force of dry friction over a step of `h: [W]` s, and its rise over it, `[n, W]` both.

    Each joint moves as under constant torque. It slides, or slides and turns round, or slides until
    it stops and is then held by just the force that holds it. So joints stick without creeping
    whatever the step, and nothing is stiff, unlike with a smoothed sign.

    Joints act on each other through the inverse mass. A sweep of Gauss-Seidel at the start of the
    step begins with the forces that would stop all of them at once. One in its middle goes on from
    there.
    """
    n = sample.model.plant.joint_dim
    x = jnp.stack(at.x)
    v, wide = x[n:], _lift(h, x[:n])

    def rub(state, late):
        """Friction as at a state of the step and its level as at a speed. The state in the middle
        of the step under it, and the speed that is typical of the step.
        """
        z, speed, force = state
        pull = _pulled(sample, at._replace(x=z, t=at.t + late * h), speed, by)
        force = jnp.where(late > 0, force, _holding(pull, v, wide))
        force, rise = _sweep(pull, v, force, h)
        own = sum(pull.answer[k] * force[None, k] for k in range(n))
        end = v + wide * (pull.free + own)
        half = 0.5 * (v + end)
        middle = jnp.concatenate([x[:n] + 0.25 * wide * (v + half), half])
        return (middle, typical_speed(v, end), force), rise

    # loops, as a program with each joint and time written out would take several times as long to
    # compile; sums over the joints are written out, as a reduction of two numbers goes through a
    # library that takes longer than all the rest
    at_rest = x, v, jnp.zeros_like(v)
    (_, _, force), rise = jax.lax.scan(rub, at_rest, jnp.array([0.0, 0.5], x.dtype))
    return force, rise[-1]


class _Pull(NamedTuple):
    """What dry friction meets at a state, `[n, W]` each.

    - `free`: Accelerations without it.
    - `inertia`: What effects add, kg m^2.
    - `level`: Of friction, N m.
    - `mass [n, n, W]`, and `answer [force, acceleration, W]`: Its inverse.
    """

    free: jax.Array
    mass: jax.Array
    inertia: jax.Array
    answer: jax.Array
    level: jax.Array


def _pulled(sample: Sample, at: Instant, speed: jax.Array, by: _ByKind) -> _Pull:
    """At an instant, with the level of friction as at a `speed [n, W]`."""
    plant, x = sample.model.plant, at.x
    n = plant.joint_dim
    identity = jnp.eye(n, dtype=x.dtype).reshape((n, n) + (1,) * (x.ndim - 1))
    unit = identity + jnp.zeros_like(x[:n])[None]
    act = acting(sample, at, by.smooth, PUSHING)
    rough = acting(sample, at._replace(x=jnp.concatenate([x[:n], speed])), by.dry, ("level",))
    free = plant.deriv(sample.theta, x, at.u, act.force, act.inertia)[n:]
    mass = plant.mass_matrix(sample.theta, x[:n])
    answer = jnp.stack([jnp.stack(solve_mass(mass, act.inertia, unit[j])) for j in range(n)])
    return _Pull(free, mass, act.inertia, answer, rough.level)


def _holding(pull: _Pull, v: jax.Array, wide: jax.Array) -> jax.Array:
    """Forces `[n, W]`, within the levels, that would stop all joints within the step."""
    stop = pull.free + v / jnp.where(wide > 0, wide, 1.0)
    pushed = sum(pull.mass[:, k] * stop[None, k] for k in range(len(stop)))
    return within(-(pushed + pull.inertia * stop), pull.level)


def _sweep(pull: _Pull, v: jax.Array, force: jax.Array, h) -> tuple:
    """Mean and rise of each joint's friction `[n, W]` after one sweep, the others' given."""

    def turn(rubs, j):
        force, rise = rubs
        own = pull.answer[j, j]
        others = sum(pull.answer[k, j] * force[k] for k in range(len(force)))
        torque = (pull.free[j] + others) / own - force[j]
        mean, slope = mean_friction(v[j], torque, pull.level[j], 1.0 / own, h)
        return (force.at[j].set(mean), rise.at[j].set(slope)), None

    start = (force, jnp.zeros_like(force))
    return jax.lax.scan(turn, start, jnp.arange(len(force)))[0]
