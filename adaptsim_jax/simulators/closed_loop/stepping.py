"""One joint in closed loop with its servo, over many pieces and for many laws at once.

A step is implicit in the speed, the limit included, since a servo's damping stops a light joint
within less than a millisecond. Dry friction is the force that would stop the joint within the step,
within its level.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.simulators.closed_loop.criteria import CLOSED_LOOP
from adaptsim_jax.simulators.closed_loop.imposed import JointProblem, Lanes
from adaptsim_jax.simulators.closed_loop.law import ServoLaw, stack_laws

SOFT_RATE, SOFT_IMPEDANCE = 2.0 / (0.95 * 0.02), 0.9  # of MuJoCo's dry friction, as it stands


def overdamped(kp: Any, damping: Any, inertia: Any) -> Any:
    """0 of a lightly damped loop, 1 of one that is damped far beyond critically."""
    damping_power, critical = (
        damping**4,
        (4.0 * kp * inertia) ** 2,
    )  # the ratio's squares, above and below
    return damping_power / (damping_power + critical + 1e-300)


def half_step_damping(kp: Any, damping: Any, inertia: Any, step: float) -> Any:
    """Damping, N m s/rad, by which a step that takes the position error at its beginning is right
    to second order where damping rules: half of what kp gains in a step.

    Where inertia rules the target has to come half a step later instead (`target_delay`).
    """
    return 0.5 * step * kp * overdamped(kp, damping, inertia)


def target_delay(kp: Any, damping: Any, inertia: Any, step: float) -> Any:
    """Return by how much a target is to be late, s, so that a step is right to second order."""
    return 0.5 * step * (1.0 - overdamped(kp, damping, inertia))


def targets_of(delay, area, history: int, step: float):
    """Mean target [S, B, P] of each step, late by `delay` [B] s, from its running integral
    [P, H + S + 2], which is linear between grid points.
    """
    steps = area.shape[1] - history - 2
    at = jnp.arange(steps + 1)[None] + history - delay[:, None] / step  # [B, S + 1]
    low = jnp.clip(jnp.floor(at).astype(int), 0, area.shape[1] - 2)
    share = (at - low)[None]
    there = area[:, low] * (1.0 - share) + area[:, low + 1] * share  # [P, B, S + 1]
    return jnp.transpose(jnp.diff(there, axis=2) / step, (2, 1, 0))


@partial(jax.jit, static_argnames=("history", "by_speed", "slides"))
def _angles(law: ServoLaw, lane: Lanes, fixed, step, history: int, by_speed: bool, slides: bool):
    """Angles [B, P, R] at the rows. fixed: damping of the joint alone, inverse weight, ends of the
    range, rest of its spring.
    """
    passive, ease, low, high, rest = fixed
    delay = law.delay + target_delay(
        law.kp, law.damping, jnp.mean(lane.tables[:, 0]) + law.rotor, step
    )
    target = targets_of(delay, lane.area, history, step)
    law = ServoLaw(*(z[:, None] for z in law))
    outer = jnp.minimum(passive, law.damping)
    inner = law.damping - outer
    limited_damping, free_damping = law.inside * inner, outer + (1.0 - law.inside) * inner
    filter_share = jnp.where(law.lag > 1e-6, 1.0 - jnp.exp(-step / jnp.maximum(law.lag, 1e-6)), 1.0)
    softness = SOFT_IMPEDANCE / (1.0 - SOFT_IMPEDANCE) / ease

    def step_once(carry, now):
        q, v, u = carry
        target, table = now
        (
            own_inertia,
            coupling,
            gravity,
            turned_gravity,
            load_inertia,
            more_c,
            more_g,
            more_t,
            imposed,
        ) = table[:, None]
        u = u + filter_share * (target - u)
        x = q - imposed - law.zero
        cos, sin = (jnp.ones_like(x), jnp.zeros_like(x)) if slides else (jnp.cos(x), jnp.sin(x))
        weight = gravity * cos + turned_gravity * sin
        inertia = own_inertia + law.rotor + law.payload * load_inertia
        load = (
            coupling
            + law.payload * (more_c + more_g * cos + more_t * sin)
            + (1 - law.lift) * weight
        )
        load = load + law.spring * (q - law.zero - rest)
        if by_speed:
            servo_force, step_damping = inner * (u + law.offset), 0.0
        else:
            servo_force = law.kp * (u + law.offset - q)
            step_damping = half_step_damping(law.kp, law.damping, inertia, step)

        def speed_after(rub):
            """Speed after the step under dry friction."""
            push = rub - load
            v1 = (inertia * v + step * (servo_force + push)) / (
                inertia + step * (limited_damping + free_damping + step_damping)
            )
            force = servo_force - (limited_damping + step_damping) * v1
            v2 = (inertia * v + step * (jnp.clip(force, -law.limit, law.limit) + push)) / (
                inertia + step * free_damping
            )
            return jnp.where(jnp.abs(force) <= law.limit, v1, v2)

        frictionless_speed = speed_after(0.0)
        holding_friction = (
            -frictionless_speed
            * (inertia + step * (limited_damping + free_damping + step_damping))
            / step
        )
        servo = jnp.clip(servo_force - limited_damping * v, -law.limit, law.limit)
        acceleration = (servo - free_damping * v - load) / inertia
        creeping_friction = -softness * (SOFT_RATE * v + acceleration) / (1.0 + softness / inertia)
        v = speed_after(
            jnp.clip(
                jnp.where(law.sharp > 0.0, holding_friction, creeping_friction), -law.rub, law.rub
            )
        )
        free_q = q + step * v
        q = jnp.clip(free_q, low, high)
        return (q, jnp.where(q == free_q, v, 0.0), u), q

    ones = jnp.ones_like(law.kp)
    begin = ones * lane.begin[0][None], ones * lane.begin[1][None], target[0]
    _, path = jax.lax.scan(step_once, begin, (target, lane.tables))
    path = jnp.transpose(jnp.concatenate([begin[0][None], path]), (1, 2, 0))  # [B, P, S + 1]
    row = jnp.broadcast_to(lane.row[None], (len(path), *lane.row.shape))
    before, after = (jnp.take_along_axis(path, row + k, 2) for k in (0, 1))
    return before + lane.share[None] * (after - before)


def errors(problem: JointProblem, laws: list[ServoLaw]) -> np.ndarray:
    """Simulated less measured angles [B, P, R] of several laws, 0 where no row is compared."""
    lane, servo, size, parts = problem.lanes, problem.servo, CLOSED_LOOP.batch, []
    history = round(CLOSED_LOOP.history / problem.step)
    with jax.enable_x64(True):
        for k in range(0, len(laws), size):
            batch = laws[k : k + size]
            padded = stack_laws([*batch, *[batch[-1]] * (size - len(batch))])
            angles = _angles(
                ServoLaw(*(jnp.asarray(z) for z in padded)),
                lane,
                jnp.asarray([servo.passive, problem.ease, *problem.ends, servo.rest]),
                problem.step,
                history,
                servo.follows_speed,
                servo.slides,
            )
            parts.append(np.asarray(angles)[: len(batch)])
    error = np.concatenate(parts) - np.asarray(lane.measured)
    error = np.where(np.isfinite(error), np.clip(error, -1e3, 1e3), 1e3)
    return error * np.asarray(lane.counted)


def squared(error: np.ndarray) -> np.ndarray:
    """Sum of squares over rows."""
    return np.square(error).sum(-1)
