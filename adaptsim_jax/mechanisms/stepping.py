"""Time stepping of a plant with effects: forces, dry friction by its mean over a step, memories
relaxed exactly.

Any axes of a batch lie last. Effects are evaluated once for all joints and the four Runge-Kutta
stages are a loop, so the graph stays small and vectorises.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from adaptsim_jax.effects.base import Dry, Motion, Relaxation
from adaptsim_jax.effects.layout import Layout
from adaptsim_jax.mechanisms.dry_friction import (
    mean_friction,
    sharp_friction,
    typical_speed,
    within,
)
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


def motion_of(model: PlantModel, theta, q, v, u, t, memory) -> Motion:
    """What effects see at `q, v, u: [n, ...]` and `t: [...]` or a scalar."""
    return Motion(q, v, u, _lift(t, q), memory, lambda q: model.plant.gravity_force(theta, q))


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
    """Sums over the effects at a state, `[n, ...]` each: smooth force, dry friction (N m), inertia
    (kg m^2), and the friction times the width within which it turns (W); None for what was not
    asked for.
    """

    force: Sum
    level: Sum
    inertia: Sum
    blur: Sum


PUSHING = ("force", "inertia")
RUBBING = ("level", "blur")


def acting(
    model: PlantModel,
    theta,
    eff,
    memory,
    x,
    u,
    t,
    effects: list | None = None,
    only: tuple[str, ...] = ActingSums._fields,
) -> ActingSums:
    """What the force effects do at `x`, `[S, ...]` or as many `[...]`. effects: others are left
    out, none where None; only: fields that are wanted.
    """
    n = model.plant.joint_dim
    every = list(model.layout.placed("force"))
    memories = dict(zip((e.name for e in every if e.memory), memory, strict=True))
    effects = every if effects is None else effects
    x = [jnp.asarray(z) for z in x]
    zero = jnp.zeros((n, *x[0].shape), x[0].dtype)
    total = ActingSums(*(zero if field in only else None for field in ActingSums._fields))

    def params(effect):
        return model.layout.params(effect, eff, jnp.ndim(x[0]))

    if "inertia" in only:  # numbers that no state changes: zero where the effect is off
        total = total._replace(
            inertia=sum([e.apply(params(e)) for e in effects if e.inertia], total.inertia)
        )
    for effect in (e for e in effects if not e.inertia):
        w = memories.get(effect.name, zero)
        answer = effect.apply(
            params(effect), motion_of(model, theta, jnp.stack(x[:n]), jnp.stack(x[n:]), u, t, w)
        )
        fields = {"force": answer.force if isinstance(answer, (Dry, Relaxation)) else answer}
        if isinstance(answer, Dry):
            fields |= {"level": answer.level, "blur": answer.level * answer.width}
        total = total._replace(
            **{field: getattr(total, field) + fields[field] for field in fields if field in only}
        )
    return total


def remember(model: PlantModel, theta, eff, memory, x, u, t, h) -> tuple[jax.Array, ...]:
    """The effects' memories after `h` s at a constant state (S times `[W]`)."""
    n = model.plant.joint_dim
    out = []
    for effect, w in zip(
        (e for e in model.layout.placed("force") if e.memory), memory, strict=True
    ):
        motion = motion_of(model, theta, jnp.stack(x[:n]), jnp.stack(x[n:]), u, t, w)
        out.append(relax(effect.apply(model.layout.params(effect, eff, 1), motion), w, h))
    return tuple(out)


def row_step(model: PlantModel, theta, eff, x, memory, u, t, h):
    """States and memories after a row of `h: [W]` s from `x`, S times `[W]`: Runge-Kutta 4,
    memories relaxed exactly by half a row on each side of it (Strang splitting). A state at a time,
    since stacking them costs more than the dynamics do.
    """
    kind = jnp.result_type(x[0])
    stages = (jnp.array([0.0, 0.5, 0.5, 1.0], kind), jnp.array([1.0, 2.0, 2.0, 1.0], kind) / 6.0)
    x = list(x)
    smooth, dry, sharp = _sorted(model, theta, eff, x, u, t)
    memory = remember(model, theta, eff, memory, x, u, t, 0.5 * h)
    rub = rise = jnp.zeros((model.plant.joint_dim, *x[0].shape), kind)
    if dry:
        rub, rise = _dry_force(model, theta, eff, memory, jnp.stack(x), u, t, h, smooth, dry, sharp)

    def stage(inner, ab):
        slope, total = inner
        a, b = ab
        at = [z + a * h * d for z, d in zip(x, slope, strict=True)]
        act = acting(model, theta, eff, memory, at, u, t + a * h, smooth, PUSHING)
        force = act.force + (rub + (a - 0.5) * rise)
        slope = model.plant.rates(theta, at, u, force, act.inertia)
        return (slope, [t + b * d for t, d in zip(total, slope, strict=True)]), None

    zero = [jnp.zeros_like(z) for z in x]
    (_, total), _ = jax.lax.scan(stage, (zero, zero), stages)
    end = [z + h * t for z, t in zip(x, total, strict=True)]
    return end, remember(model, theta, eff, memory, end, u, t + h, 0.5 * h)


def _sorted(model: PlantModel, theta, eff, x, u, t) -> tuple[list, list, bool]:
    """The force effects that push smoothly or add inertia, and those that rub dry (some do both),
    whether all without a width.
    """
    smooth, dry, wide = [], [], []

    def answer(effect):
        q, v = jnp.split(jnp.stack(x), 2)
        response = effect.apply(
            model.layout.params(effect, eff, 1),
            motion_of(model, theta, q, v, u, t, jnp.zeros_like(q)),
        )
        rubs = isinstance(response, Dry)
        dry.extend([effect] if rubs else [])
        wide.extend([effect] if rubs and not isinstance(response.width, float) else [])
        smooth.extend(
            [] if rubs and isinstance(response.force, float) and response.force == 0.0 else [effect]
        )

    for effect in model.layout.placed("force"):
        if effect.inertia:
            smooth.append(effect)
        else:
            jax.eval_shape(lambda effect=effect: answer(effect))
    return smooth, dry, not wide


def _dry_force(
    model: PlantModel, theta, eff, memory, x, u, t, h, smooth: list, dry: list, sharp: bool
):
    """Mean force of dry friction over a step of `h: [W]` s and its rise over the step, `[n, W]`
    both.

    Each joint moves as under constant torque: it slides, or slides and turns round, or slides until
    it stops and is then held by just the force that holds it. So joints stick without creeping
    whatever the step, and nothing is stiff, unlike with a smoothed sign. Joints act on each other
    through the inverse mass: a sweep of Gauss-Seidel at the start of the step, from the forces that
    would stop all of them at once, and one from there in its middle.
    """
    n, plant = model.plant.joint_dim, model.plant
    v, wide = x[n:], _lift(h, x[:n])
    unit = (
        jnp.eye(n, dtype=x.dtype).reshape((n, n) + (1,) * (x.ndim - 1))
        + jnp.zeros_like(x[:n])[None]
    )

    if sharp:

        def mean_of(v, torque, level, _, *inert):
            return sharp_friction(v, torque, level, *inert)
    else:
        mean_of = mean_friction

    def rub(at, late):
        """Friction as at a state of the step and its level as at a speed. The state in the middle
        of the step under it, and the speed that is typical of the step.
        """
        z, speed, force = at
        now = t + late * h
        act = acting(model, theta, eff, memory, z, u, now, smooth, PUSHING)
        rough = acting(
            model, theta, eff, memory, jnp.concatenate([z[:n], speed]), u, now, dry, RUBBING
        )
        inertia, level = act.inertia, rough.level
        width = jnp.where(
            late > 0, rough.blur / jnp.maximum(level, 1e-9), 0.0
        )  # only once: it is most of the work
        free = plant.deriv(theta, z, u, act.force, inertia)[n:]
        mass = plant.mass_matrix(theta, z[:n])
        answer = jnp.stack(
            [jnp.stack(solve_mass(mass, inertia, unit[j])) for j in range(n)]
        )  # [force, acceleration]
        stop = free + v / jnp.where(wide > 0, wide, 1.0)
        hold = within(-(sum(mass[:, k] * stop[None, k] for k in range(n)) + inertia * stop), level)
        force = jnp.where(late > 0, force, hold)

        def turn(rubs, j):
            """One joint's, the others' given."""
            force, rise = rubs
            own = answer[j, j]
            torque = (free[j] + sum(answer[k, j] * force[k] for k in range(n))) / own - force[j]
            mean, slope = mean_of(v[j], torque, level[j], width[j], 1.0 / own, h)
            return (force.at[j].set(mean), rise.at[j].set(slope)), None

        (force, rise), _ = jax.lax.scan(turn, (force, jnp.zeros_like(force)), jnp.arange(n))
        end = v + wide * (free + sum(answer[k] * force[None, k] for k in range(n)))
        half = 0.5 * (v + end)
        middle = jnp.concatenate([x[:n] + 0.25 * wide * (v + half), half])
        return (middle, typical_speed(v, end), force), rise

    # loops, as a program with each joint and time written out would take several times as long to
    # compile; sums over the joints are written out, as a reduction of two numbers goes through a
    # library that takes longer than all the rest
    (_, _, force), rise = jax.lax.scan(
        rub, (x, v, jnp.zeros_like(v)), jnp.array([0.0, 0.5], x.dtype)
    )
    return force, rise[-1]
