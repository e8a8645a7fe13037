"""What acts on a tree of joints besides its own dynamics: actuators, effects, dry friction; values
of a model. Stretches lie last.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.attribution.criteria import FRICTION
from adaptsim_jax.effects.base import Drive, Dry, Effect, Motion
from adaptsim_jax.effects.joints.drives import DRIVE_COMPLIANCE, DRIVE_PLAY
from adaptsim_jax.effects.joints.friction import VISCOUS
from adaptsim_jax.effects.joints.sensor import ENCODER_OFFSET
from adaptsim_jax.mechanisms import equations
from adaptsim_jax.mechanisms.dynamics import compensation
from adaptsim_jax.mechanisms.tree import Tree

OF_CONTROLLERS = frozenset(e.name for e in (ENCODER_OFFSET, DRIVE_COMPLIANCE, DRIVE_PLAY))
"""Effects by which the angle that a controller follows is another than the joint's."""


class Values(NamedTuple):
    """Numbers of a model of n joints. Every leaf has a last axis of 1, or of one number a stretch.

    inertial [n, 10, .]; gravity [3, .] m/s^2; actuator [6, n, .]: gain, bias, bias per angle, bias
    per speed, lowest and highest force, before the gear [n, .]; effects {name: {parameter: [n,
    .]}}; ties [n, n, .]: gears by which a joint's actuator pulls other joints as well (a tendon),
    None where none does; read [n, .]: angles that the sensors gave where a stretch begins; ease [n,
    .]: inverse weights of the joints over the file's, by which what MuJoCo makes soft gives.
    """

    inertial: Any
    gravity: Any
    actuator: Any
    gear: Any
    effects: dict[str, dict[str, Any]]
    ties: Any = None
    read: Any = None
    ease: Any = 1.0


@dataclass(frozen=True)
class ActingModel:
    """A tree and the effects that may act on its joints (static: what is compiled)."""

    tree: Tree
    effects: tuple[Effect, ...]


jax.tree_util.register_dataclass(ActingModel, data_fields=["tree"], meta_fields=["effects"])


def sensed_offset(values: Values):
    """What the encoders add to the angles, which the actuators' controllers see too, [n, .]."""
    if ENCODER_OFFSET.name in values.effects:
        return values.effects[ENCODER_OFFSET.name]["offset"]
    return 0.0


def actuated(values: Values, q, v, u):
    """(force of the actuators, the part of it that follows command and angle), `[n, ...]`, N m or
    N; q and v are those of their own encoders.
    """
    gain, bias, per_q, per_v, low, high = values.actuator
    g = values.gear
    q = q + sensed_offset(values)
    along, rate = g * q, g * v
    if values.ties is not None:
        along, rate = along + _tied(values.ties, q), rate + _tied(values.ties, v)
    pull = gain * u + bias + per_q * along
    # a controller's encoder on the motor's side sees the drive's wind-up and play, too
    yields = 1.0 - wound(values) * g * g * per_q
    pull = pull - _played(values, g * (pull + per_v * rate)) / g
    force, follows = jnp.clip((pull + per_v * rate) / yields, low, high), pull / yields
    if values.ties is None:
        return g * force, g * follows
    back = jnp.swapaxes(values.ties, 0, 1)
    return g * force + _tied(back, force), g * follows + _tied(back, follows)


def _tied(ties, x):
    """Row by row the sum over joints `[n, n, .]` times `[n, .]`."""
    return sum(ties[:, j] * x[j][None] for j in range(ties.shape[1]))


def held_by(values: Values):
    """Stiffness and damping [n, .] that hold each joint without delay: of controllers, and viscous
    friction.
    """
    square = values.gear**2
    if VISCOUS.name in values.effects:
        damping = values.effects[VISCOUS.name]["damping"]
    else:
        damping = 0.0
    return -square * values.actuator[2], damping - square * values.actuator[3]


def wound(values: Values):
    """Wind-up of the drives under torque, [n, .] rad/(N m)."""
    if DRIVE_COMPLIANCE.name in values.effects:
        return values.effects[DRIVE_COMPLIANCE.name]["compliance"]
    return 0.0


def _played(values: Values, torque):
    """What a controller on the motor's side gives less, since its encoder turns through the play
    towards where it pulls: it lies against a side of the play as `drive_play` has it of the torque
    that is left.
    """
    if DRIVE_PLAY.name not in values.effects:
        return 0.0
    p = values.effects[DRIVE_PLAY.name]
    most = -0.5 * p["gap"] * values.gear**2 * values.actuator[2]
    return most * jnp.clip(torque / jnp.maximum(most + p["width"], 1e-12), -1.0, 1.0)


def carried(values: Values, x, u):
    """Torque of the drives [L+1, n, W] at states x [L+1, 2n, W] under commands u [L, n, W]."""
    n = x.shape[1] // 2
    return jax.vmap(lambda x, u: actuated(values, x[:n], x[n:], u)[0])(
        x, jnp.concatenate([u, u[-1:]])
    )


class Forces(NamedTuple):
    """`[n, ...]`: smooth force (actuator and effects), level of dry friction, added inertia,
    compliance of bristles.
    """

    smooth: Any
    level: Any
    inertia: Any
    yielding: Any


def forces(model: ActingModel, values: Values, q, v, u, t, observed=None) -> Forces:
    """All that acts on the joints besides their own dynamics. seen: angles and speeds as the
    controllers have them, where they are other than q and v.
    """
    observed_q, observed_v = observed or (q, v)
    tau, pull = actuated(values, observed_q, observed_v, u)

    def gravity(q):
        return equations.gravity_force(model.tree, values.inertial, q, values.gravity)

    motion = Motion(q, v, tau, t, gravity, pull, u + jnp.zeros_like(q))
    nothing = jnp.zeros(jnp.broadcast_shapes(tau.shape, jnp.shape(values.inertial[:, 0])), q.dtype)
    smooth, level, inertia, yielding = tau + nothing, nothing, nothing, nothing
    held_up = compensation(model.tree, q)
    smooth = smooth if held_up is None else smooth + held_up
    for effect in model.effects:
        if effect.place != "force" or effect.name not in values.effects:
            continue
        p = values.effects[effect.name]
        if effect.inertia:
            inertia = inertia + effect.apply(p)
        elif rubs_dry(effect)[0]:

            def rubs(z, e=effect, p=p):
                return _rubbing(z, e.apply(p, motion))

            smooth, level, yielding = _where_on(effect, p, rubs, (smooth, level, yielding))
        else:
            smooth = _where_on(effect, p, lambda z, e=effect, p=p: z + e.apply(p, motion), smooth)
    return Forces(smooth, level, inertia, yielding)


def _rubbing(total, dry: Dry):
    smooth, level, yielding = total
    return smooth + dry.force, level + dry.level, yielding + dry.yielding


def _where_on(effect: Effect, p, added, total):
    """added(total) if the effect does anything to any joint of any stretch: what is off costs
    nothing.
    """
    on = [jnp.any(p[a.name] != a.default) for a in effect.amplitudes if a.name in p]
    return jax.lax.cond(jnp.any(jnp.stack(on)), added, lambda z: z, total)


def rough(model: ActingModel, values: Values) -> bool:
    """Whether anything may rub dry."""
    return any(rubs_dry(e)[0] for e in model.effects if _on(e, values))


def bristles(model: ActingModel, values: Values) -> bool:
    """Whether dry friction yields anywhere."""
    return any(rubs_dry(e)[1] for e in model.effects if _on(e, values))


def _on(effect: Effect, values: Values) -> bool:
    p = values.effects.get(effect.name, {})
    return any(np.any(np.asarray(p[a.name]) != a.default) for a in effect.amplitudes if a.name in p)


@cache
def rubs_dry(effect: Effect) -> tuple[bool, bool]:
    """Whether an effect rubs dry, and whether what rubs yields."""
    if effect.place != "force" or effect.inertia:
        return False, False
    number, answers = jax.ShapeDtypeStruct((1, 1), np.float32), []

    def ask(p, z):
        answers.append(effect.apply(p, Motion(z, z, z, z, lambda q: q, z, z)))
        return z

    jax.eval_shape(ask, {p.name: number for p in effect.parameters}, number)
    dry = isinstance(answers[0], Dry)
    return dry, dry and not isinstance(answers[0].yielding, float)


def bent_at(model: ActingModel, values: Values, x, u, t):
    """Deflection [n, W] of bristles at the start of stretches that begin at x [2n or more, W]: bent
    as by the motion just before.
    """
    n = model.tree.n
    q, v = x[:n], x[n : 2 * n]
    act = forces(model, values, q, v, u, t[None])
    most = act.yielding * jnp.maximum(act.level, 0.0)
    return jnp.clip(FRICTION.bent * v, -most, most)


def drive_of(model: ActingModel, values: Values) -> Drive:
    """What the effects of the place `drive` come to: springs and plays in a row, of those that have
    a compliance.
    """
    parts = [
        e.apply(values.effects[e.name])
        for e in model.effects
        if e.place == "drive" and e.name in values.effects
    ]
    parts = [
        jax.tree.map(lambda z, on=part.compliance > 0.0: jnp.where(on, z, 0.0), part)
        for part in parts
    ]
    return Drive(*(sum(some) for some in zip(*parts, strict=True)))


def compliant(model: ActingModel, values: Values) -> np.ndarray:
    """[n], whether a joint's drive gives."""
    some = [e for e in model.effects if e.place == "drive" and e.name in values.effects]
    each = [
        np.any(np.asarray(e.apply(values.effects[e.name]).compliance) > 0.0, axis=1) for e in some
    ]
    return np.any([np.zeros(model.tree.n, bool), *each], axis=0)


def gives(model: ActingModel, values: Values) -> bool:
    """Whether any drive does."""
    return bool(np.any(compliant(model, values)))
