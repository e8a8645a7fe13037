"""Dry friction on one joint over a step: its mean, from how the joint moves under a constant other
torque.

Sharp friction turns with the sign of the speed and holds a joint that it stops; one with a width
turns as tanh(v / width), and what it holds creeps. Neither is stiff here: the mean is that of the
motion over the step, whatever the step.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

NEWTON = 4  # steps for the speed at which a joint creeps
PARTS = 4  # of a step of friction with a width
SLOW = 4.0  # widths, up to which a speed follows its equilibrium
LITTLE = 1.2  # times its level, up to which torques leave a joint there
ROUNDS = 3  # for the end of a step under a force that is smooth
STIFF = 30.0  # steps in time constants, beyond which it is not smooth


def typical_speed(v, end):
    """The speed at which what grows with its square is at its mean, straight from `v` to `end`. The
    way of most of it.
    """
    mean = (v**2 + v * end + end**2) / 3.0
    return jnp.sign(v + end) * jnp.sqrt(mean + jnp.finfo(mean.dtype).tiny)


def within(force, level):
    """`force` limited to `level`, with the right slope where the level is zero."""
    return level * jnp.clip(force / jnp.maximum(level, 1e-9), -1.0, 1.0)


def sharp_friction(v, torque, level, inertia, h):
    """`mean_friction` without a width."""
    return _sharp(v, torque, level, inertia, h)[1:]


@jax.custom_jvp
def mean_friction(v, torque, level, width, inertia, h):
    """Friction [N m] on one joint over `h` s that moves at `v` [rad/s] under a constant other
    `torque` [N m]; all `[...]`.

    Its mean and its rise over the step, a line with the same first moment: so both speed and angle
    are right after a step in which the joint turns.

    Args:
        width [rad/s]: 0 is sharp.
    """

    def sharp():
        return sharp_friction(v, torque, level, inertia, h)

    return jax.lax.cond(
        jnp.any(width > 0), lambda: _in_parts(v, torque, level, width, inertia, h / PARTS), sharp
    )


@mean_friction.defjvp
def _by_partials(primals, tangents):
    """Along many directions at the cost of one for each argument: a fit has more parameters than
    friction has arguments.
    """
    primals = tuple(jnp.broadcast_arrays(*primals))
    one, count = primals[0], len(primals)
    identity = jnp.eye(count, dtype=one.dtype).reshape(count, count, *(1,) * one.ndim)
    ways = jnp.broadcast_to(identity, (count, count, *one.shape))

    def along(*way):
        return jax.jvp(mean_friction.fun, primals, way)

    answer, partials = jax.vmap(along, out_axes=(None, 0))(*ways)
    return answer, tuple(
        sum(p * t for p, t in zip(partial, tangents, strict=True)) for partial in partials
    )


def _in_parts(v, torque, level, width, inertia, h):
    """The same over `PARTS` steps of `h` s, in each of which a width changes less."""

    def part(v, _):
        share, sharp, _ = _sharp(v, torque, level, inertia, h)
        step = _Step(v, torque, level, width, inertia, jnp.where(h > 0, h, 1.0))
        mean = sharp + _of_width(step, share, sharp)
        return v + h * (torque + mean) / inertia, mean

    means = jax.lax.scan(part, v, length=PARTS)[1]
    middles = ((jnp.arange(PARTS, dtype=means.dtype) + 0.5) / PARTS - 0.5).reshape(
        PARTS, *(1,) * v.ndim
    )
    return means.mean(0), 12.0 * (middles * means).sum(0) / PARTS


def _sharp(v, torque, level, inertia, h):
    """The share of the step for which the joint slides on, and the mean and rise of sharp friction:
    then it holds, or the joint slides the other way.
    """
    way = jnp.sign(v)
    slow = level - way * torque  # what brakes it
    share = jnp.abs(v) * inertia / (jnp.where(h > 0, h, 1.0) * jnp.maximum(slow, 1e-9))
    share = jnp.where(
        (slow > 0) & (level >= 0), jnp.minimum(share, 1.0), 1.0
    )  # a fit may try a negative level
    first, then = -level * way, within(-torque, level)
    return share, first * share + (1.0 - share) * then, 6.0 * share * (1.0 - share) * (then - first)


class _Step(NamedTuple):
    """A joint over `h` s, as of `mean_friction`."""

    v: jax.Array
    torque: jax.Array
    level: jax.Array
    width: jax.Array
    inertia: jax.Array
    h: jax.Array


def _of_width(step: _Step, share, sharp):
    """What the width adds to the mean of sharp friction: by the motion under the sharp one where
    the width is soon passed, and under a smooth force where it is not.
    """
    v, torque, level, width, inertia, h = step
    safe, strong = (
        jnp.where(width > 0, jnp.maximum(width, 1e-6), 1e-3),
        jnp.maximum(level, 1e-9),
    )  # finite where sharp

    def after(friction):
        return v + h * (torque + friction) / inertia

    end = after(sharp)
    crept = inertia / h * (_creeping(v, torque, strong, safe, inertia, h) - v) - torque
    sliding = sharp - level * _less(v, end, share, safe)
    sliding = sharp - level * _less(v, after(sliding), share, safe)
    stops = (share < 1.0) & (jnp.abs(torque) <= level)
    near = (jnp.abs(v) < SLOW * width) & (jnp.abs(torque) < LITTLE * level)
    narrow = jnp.where(stops | near, crept, sliding)
    hard = h * strong / inertia
    loose = jnp.maximum(
        safe, hard / STIFF
    )  # where it counts for nothing its slope stays within single precision
    wide = -level * jnp.tanh(v / loose)
    for _ in range(ROUNDS):
        wide = -level * _along(v, after(wide), loose)
    stiff = jnp.minimum(hard / safe, 1e3) ** 4
    mean = wide + (narrow - wide) * stiff / (1.0 + stiff)
    return jnp.where((width > 0) & (level > 0), mean - sharp, 0.0)


def _short(speed, width):
    """By how much the integral of tanh(v / width) to `speed` >= 0 falls short of that of the
    sign.
    """
    return width * (jnp.log(2.0) - jnp.log1p(jnp.exp(-2.0 * speed / width)))


def _along(v, end, width):
    """Mean of tanh(v / width) straight from `v` to `end`."""
    gap = end - v
    near = jnp.abs(gap) < 1e-3 * width

    def reached(v):
        return jnp.abs(v) - _short(jnp.abs(v), width)

    halfway = jnp.tanh(0.5 * (v + end) / width)
    mean = (reached(end) - reached(v)) / jnp.where(near, 1.0, gap)
    return jnp.where(near, halfway, mean)


def _less(v, end, share, width):
    """Mean of tanh(v / width) less that of the sign, on the way from `v` to `end`, by way of rest
    if `share` of the step is less than all of it.
    """

    def part(speed):
        return _short(speed, width) / jnp.maximum(speed, 1e-12)

    until_rest = -jnp.sign(v) * part(jnp.abs(v)) * share
    turned = until_rest - jnp.sign(end) * part(jnp.abs(end)) * (1.0 - share)
    straight = jnp.sign(v) * (_along(jnp.abs(v), jnp.abs(end), width) - 1.0)
    return jnp.where(share < 1.0, turned, straight)


def _creeping(v, torque, level, width, inertia, h):
    """Speed at the end of a step in which friction all but stops the joint, or lets it go.

    It solves `inertia (end - v) / h = torque - level mean` with tanh at both ends as the mean,
    weighed as an exponential decay has it, so that a stiff joint is at its equilibrium.
    """
    stiff = h * level / (inertia * width)
    firm = stiff > 1e-3
    late = 1.0 / -jnp.expm1(-jnp.maximum(stiff, 1e-3)) - 1.0 / jnp.maximum(stiff, 1e-3)
    late = jnp.where(firm, late, 0.5)
    mass, most = inertia / h, late * level
    goal = v + (torque - (1.0 - late) * level * jnp.tanh(v / width)) / mass
    way = jnp.where(goal < 0, -1.0, 1.0)
    goal = way * goal
    minimum = jnp.maximum(goal - most / mass, 0.0)

    def limited(z):
        return jnp.where(
            z > goal, goal, jnp.where(z < minimum, minimum, z)
        )  # at rest too its slope is that of `z`

    speed = width * jnp.arctanh(jnp.minimum(mass * goal / (most + mass * width), 0.999))
    speed = limited(speed)
    for _ in range(NEWTON):
        turn = jnp.tanh(speed / width)
        slope = mass + most * (1.0 - turn**2) / width
        speed = limited(speed - (mass * (speed - goal) + most * turn) / slope)
    return way * speed
