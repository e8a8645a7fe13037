"""Ends of declared ranges, as MuJoCo has them: a soft constraint whose force brings about a
reference acceleration.

MuJoCo's documentation, "Computation", constraint model: of a joint r beyond its range at the speed
v the reference acceleration is -b v - k d(r) r with the impedance d. B, k and d come from `solref`
and `solimp`.
"""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.mechanisms import equations
from adaptsim_jax.mechanisms.tree import Tree


def limited(tree: Tree) -> np.ndarray:
    """Joints [k] whose range may end the motion."""
    return np.flatnonzero(tree.limited)


def rates(stop: Any) -> tuple[Any, Any]:
    """Stiffness 1/s^2 and damping 1/s of the reference acceleration, of rows `stop [.., 8]`
    (solref, solimp, inverse weight).
    """
    time, ratio, most = stop[..., 0], stop[..., 1], stop[..., 3]
    direct = time <= 0
    safe = jnp.where(direct, 1.0, time)
    stiffness = jnp.where(
        direct, -time / most**2, 1.0 / jnp.maximum(most * safe * ratio, 1e-9) ** 2
    )
    return stiffness, jnp.where(direct, -ratio / most, 2.0 / (most * safe))


def impedance(stop: Any, depth: Any) -> Any:
    """Share d of the reference that a joint `far` [..] rad (m) beyond its range gets."""
    first, last, width, middle, power = (stop[..., k] for k in (2, 3, 4, 5, 6))
    x = jnp.clip(depth / jnp.maximum(width, 1e-12), 0.0, 1.0)
    low = x**power / jnp.maximum(middle, 1e-9) ** (power - 1.0)
    high = 1.0 - (1.0 - x) ** power / jnp.maximum(1.0 - middle, 1e-9) ** (power - 1.0)
    return jnp.clip(first + jnp.where(x <= middle, low, high) * (last - first), 1e-4, 1.0 - 1e-4)


def hold_within(tree: Tree, q: Any, v: Any) -> tuple[Any, Any, Any, Any]:
    """Of the limited joints, at q, v [n, W]: (which side the force goes, +-1; the reference
    acceleration towards it; what softness adds to the inverse inertia; whether the range is left),
    [k, W] each.
    """
    at = limited(tree)
    if isinstance(tree.stop_params, np.ndarray):
        stop = jnp.asarray(np.asarray(tree.stop_params))[at]
    else:
        stop = tree.stop_params[at]
    low, high = tree.range[at, 0][:, None], tree.range[at, 1][:, None]
    q, v, stop = q[at], v[at], stop[:, None, :]
    above, below = q - high, low - q
    side = jnp.where(above > below, -1.0, 1.0)
    depth = jnp.maximum(above, below)
    stiffness, damping = rates(stop)
    share = impedance(stop, jnp.maximum(depth, 0.0))
    reference = -damping * side * v + stiffness * share * jnp.maximum(depth, 0.0)
    return side, reference, (1.0 - share) / share * stop[..., 7], depth > 0.0


@jax.jit
def inverse_weight(tree: Tree, inertial, armature):
    """Of the coordinates at the file's zero [n, .], as if none followed another: what MuJoCo scales
    softness by. inertial [n, 10, .], armature [n, .].
    """
    if tree.all_joints is not None:
        own, every = np.array(tree.all_joints.own), tree.all_joints.tree
        more = armature - tree.armature[:, None]
        bodies = jnp.broadcast_to(
            every.inertial[..., None], (*every.inertial.shape, inertial.shape[-1])
        )
        wide = jnp.broadcast_to(every.armature[:, None], (every.n, more.shape[-1]))
        tree, inertial = every, bodies.at[own].set(inertial)
        armature = wide.at[own].add(more)
    else:
        own = np.arange(tree.n)
    zero = jnp.zeros((tree.n, max(inertial.shape[-1], armature.shape[-1])))
    inverse = equations.inverse_mass(tree, inertial, zero, armature)
    return jnp.stack([inverse[j, j] for j in own])


def with_inertial(tree: Tree, inertial: np.ndarray) -> Tree:
    """The tree with other bodies [n, 10], and with ends and friction as soft as these make them."""
    with jax.enable_x64(True):
        now, before = (
            np.asarray(inverse_weight(tree, z[..., None], tree.armature[:, None]))
            for z in (np.asarray(inertial), np.asarray(tree.inertial))
        )
    stop, rub = np.array(tree.stop_params, float), np.array(tree.friction_softness, float)
    stop[:, 7:] *= now / before
    rub[:, 1:] *= now / before
    return replace(tree, inertial=inertial, stop_params=stop, friction_softness=rub)
