"""Equations of motion of a tree: its full dynamics (`dynamics.py`), or where `tree.linear` those
linearised about rest at zero.

Linearised, the mass matrix is that of the pose at zero, gravity is followed to first order in the
angles, and there are no Coriolis and centrifugal forces: `M(0) a = force + g(0) + g'(0) q` (the
paper's double pendulum, section 5.1). Arguments and shapes are those of `dynamics.py`.
"""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp

from adaptsim_jax.mechanisms import dynamics
from adaptsim_jax.mechanisms.tree import Tree

Array = Any


def acceleration(
    tree: Tree, inertial: Array, q: Array, v: Array, force: Array, armature: Array, gravity: Array
) -> jax.Array:
    """See `dynamics.acceleration`."""
    if not tree.linear:
        return dynamics.acceleration(tree, inertial, q, v, force, armature, gravity)
    pull = gravity_force(tree, inertial, q, gravity)
    return dynamics.acceleration(
        _full(tree), inertial, 0.0 * q, 0.0 * v, force + pull, armature, 0.0 * gravity
    )


def inverse_mass(tree: Tree, inertial: Array, q: Array, armature: Array) -> jax.Array:
    """See `dynamics.inverse_mass`."""
    return dynamics.inverse_mass(tree, inertial, 0.0 * q if tree.linear else q, armature)


def mass_matrix(tree: Tree, inertial: Array, q: Array) -> jax.Array:
    """See `dynamics.mass_matrix`."""
    return dynamics.mass_matrix(tree, inertial, 0.0 * q if tree.linear else q)


def gravity_force(tree: Tree, inertial: Array, q: Array, gravity: Array) -> jax.Array:
    """See `dynamics.gravity_force`."""
    if not tree.linear:
        return dynamics.gravity_force(tree, inertial, q, gravity)
    at_zero, slope = _along(lambda q: dynamics.gravity_force(_full(tree), inertial, q, gravity), q)
    return at_zero + slope


def inverse_dynamics(
    tree: Tree, inertial: Array, q: Array, v: Array, a: Array, gravity: Array
) -> jax.Array:
    """See `dynamics.inverse_dynamics`."""
    if not tree.linear:
        return dynamics.inverse_dynamics(tree, inertial, q, v, a, gravity)
    moving = dynamics.inverse_dynamics(_full(tree), inertial, 0.0 * q, None, a, 0.0 * gravity)
    return moving - gravity_force(tree, inertial, q, gravity)


def regressor(tree: Tree, q: Array, v: Array | None, a: Array | None, gravity: Array) -> jax.Array:
    """See `dynamics.regressor`."""
    if not tree.linear:
        return dynamics.regressor(tree, q, v, a, gravity)
    at_zero, slope = _along(lambda q: dynamics.regressor(_full(tree), q, None, None, gravity), q)
    if a is None:
        moving = 0.0
    else:
        moving = dynamics.regressor(_full(tree), 0.0 * q, None, a, 0.0 * gravity)
    return at_zero + slope + moving


def _full(tree: Tree) -> Tree:
    return replace(tree, linear=False)


def _along(f, q: Array) -> tuple[jax.Array, jax.Array]:
    """`f(0)` and its derivative there along `q`."""
    q = jnp.asarray(q)
    return jax.jvp(f, (jnp.zeros_like(q),), (q,))
