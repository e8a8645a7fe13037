"""A magnet that pulls a joint towards zero, or pushes it away."""

import jax.numpy as jnp

from adaptsim_jax.diagnosis import Effect, Quantity


def magnet(p, m):
    """Torque [N m] at angles `m.q` [rad], elementwise."""
    return -p["pull"] * m.q * jnp.exp(-jnp.square(m.q / p["reach"]))


MAGNET = Effect(
    "magnet",
    "force",
    (
        Quantity("pull", "N m/rad", -5.0, 5.0),
        Quantity("reach", "rad", 0.05, 1.0, 0.3, shape=True),
    ),
    magnet,
    physics="a magnet near the angle zero",
    excitation="slow motion through zero, and wide angles",
    look_alikes=("spring", "cogging"),
    formula="-pull q exp(-(q / reach)^2)",
)
