"""Torque and dry friction that depend on the joint's angle in whatever way: linear between nodes
over the range of motion.

What no law of the catalogue describes (a magnet, a cable, a cam, a worn spot) would otherwise be
given the name of the law that is least unlike it. They are tried once no law holds out any more. A
law with fewer parameters has the name wherever it does as well.
"""

import jax.numpy as jnp

from adaptsim_jax.effects.base import Dry, Effect, Parameter

NODES = 10


def _between(p, q):
    """Value [n, ...] at angles q of what is linear between the nodes, and constant beyond them."""
    x = (NODES - 1) * jnp.clip((q - p["low"]) / (p["high"] - p["low"]), 0.0, 1.0)
    parts = [p[f"at{k}"] * jnp.maximum(0.0, 1.0 - jnp.abs(x - k)) for k in range(NODES)]
    return sum(parts, start=jnp.zeros(()))


def angle_torque(p, m):
    return _between(p, m.q)


def angle_friction(p, m):
    return Dry(_between(p, m.q))


def _parameters() -> tuple[Parameter, ...]:
    """A weak prior, so that a level which is the same everywhere is Coulomb's, and a node that no
    motion passes has none.
    """
    nodes = [
        Parameter(f"at{k}", "N m", -1.0, 1.0, 0.0, meaning=f"at node {k}", prior=0.3)
        for k in range(NODES)
    ]
    ends = [
        Parameter(
            name,
            "rad",
            -1e9,
            1e9,
            at,
            None,
            held=True,
            meaning=f"angle of the {which} node; not fitted",
        )
        for name, at, which in (("low", -1.0, "first"), ("high", 1.0, "last"))
    ]
    return (*nodes, *ends)


def _range(reach, joint):
    return [{"low": float(reach.q_low[joint]), "high": float(reach.q_high[joint])}]


BY_ANGLE: tuple[Effect, ...] = (
    Effect(
        "angle_torque",
        "force",
        _parameters(),
        angle_torque,
        "a torque that depends on the angle in a way of its own (a magnet, a cable, a cam)",
        "slow and fast passes over the whole range",
        ("cogging", "spring", "bias", "hard_stop"),
        grid=_range,
        describes=True,
        formula=f"linear in q between {NODES} nodes from low to high, constant beyond",
    ),
    Effect(
        "angle_friction",
        "force",
        _parameters(),
        angle_friction,
        "dry friction whose level depends on the angle (a worn spot, a bent shaft)",
        "reversals all over the range",
        ("coulomb", "stribeck", "load_friction", "asymmetric_coulomb"),
        grid=_range,
        describes=True,
        formula="-level(q) sign(v), level linear between nodes, beside what is there anywhere",
    ),
)
