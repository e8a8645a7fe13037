"""Dry friction on one joint over a step: its mean, from how the joint moves under a constant other
torque. It turns with the sign of the speed and holds a joint that it stops, whatever the step.
"""

import jax.numpy as jnp


def typical_speed(v, end):
    """The speed at which what grows with its square is at its mean, straight from `v` to `end`. The
    way of most of it.
    """
    mean = (v**2 + v * end + end**2) / 3.0
    return jnp.sign(v + end) * jnp.sqrt(mean + jnp.finfo(mean.dtype).tiny)


def within(force, level):
    """`force` limited to `level`, with the right slope where the level is zero."""
    return level * jnp.clip(force / jnp.maximum(level, 1e-9), -1.0, 1.0)


def mean_friction(v, torque, level, inertia, h):
    """Friction [N m] on one joint over `h` s that moves at `v` [rad/s] under a constant other
    `torque` [N m]; all `[...]`.

    Its mean and its rise over the step, a line with the same first moment: so both speed and angle
    are right after a step in which the joint turns: it slides for a share of the step, and is then
    held, or slides the other way.
    """
    way = jnp.sign(v)
    slow = level - way * torque  # what brakes it
    share = jnp.abs(v) * inertia / (jnp.where(h > 0, h, 1.0) * jnp.maximum(slow, 1e-9))
    share = jnp.where(
        (slow > 0) & (level >= 0), jnp.minimum(share, 1.0), 1.0
    )  # a fit may try a negative level
    first, then = -level * way, within(-torque, level)
    return first * share + (1.0 - share) * then, 6.0 * share * (1.0 - share) * (then - first)
