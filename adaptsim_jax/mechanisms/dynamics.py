"""Dynamics of a `Tree`: mass matrix, bias force, regressor, acceleration with derivatives,
positions and energy.

Arrays are `[n, ...batch]` with the batch last, and all is sums and products over lanes of all
joints at once, so that it vectorises, and compiles in about the same time for two joints and for
twelve. Vectors are in the world's axes, motions and wrenches about the first joint of each branch.
Inverse dynamics are the recursive Newton-Euler algorithm and the mass matrix comes from composite
bodies (Featherstone, "Rigid Body Dynamics Algorithms", 2008). Derivatives are analytic (Singh,
Russell and Wensing, "Efficient analytical derivatives of rigid-body dynamics using spatial vector
algebra", RA-L 7(2), 2022; Carpentier and Mansard, 2018), so that a derivative along many directions
costs a small matrix product each.

`inertial [n, 10]`, `gravity [3]` and `armature [n]` are arguments of their own and may carry the
batch's axes. Rows of `inertial` of bodies that are `tree.massless` are not looked at. Where joints
follow others (`tree.whole`), all is computed for all joints and brought to the coordinates at the
end; `inertial` is of the coordinates' own bodies, followers keep theirs. In what follows `full` is
the tree of all joints, `inertias` the inertial parameters of all its bodies.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core.trig import once
from adaptsim_jax.mechanisms.kinematics import Pose, chain, stack_poses, with_batch_axes
from adaptsim_jax.mechanisms.lanes import (
    IDENTITY,
    ZERO,
    Entry,
    InertialBody,
    Pair,
    Vector,
    add,
    apply,
    apply_transposed,
    cross,
    cross_motion,
    cross_wrench,
    dot,
    dot_pair,
    is_static,
    minus,
    momentum,
    move_reference,
    mul,
    plus,
    plus_pair,
    rotate_body,
    sub,
    swirl,
    symmetric,
    times,
    times_pair,
)
from adaptsim_jax.mechanisms.tree import Tree, ancestors

Array = Any


class Kinematics(NamedTuple):
    """What positions alone decide: `pose` of the frames, `screw` (the motion that each joint makes
    at unit speed), and `body` (inertias in the world's axes).
    """

    pose: Pose
    screw: Pair
    body: InertialBody


class BodyMotion(NamedTuple):
    """Of each body: velocity and acceleration (less gravity), the same of the body before it, and
    the wrench that it needs.
    """

    velocity: Pair
    acceleration: Pair
    velocity_before: Pair
    acceleration_before: Pair
    wrench: Pair


def mass_matrix(tree: Tree, inertial: Array, q: Array) -> jax.Array:
    """Compute the mass matrix `[n, n, ...]`, kg m^2 (kg m, kg where slides are concerned), at
    `q: [n, ...]`, without armature.
    """
    q = jnp.asarray(q)
    full, inertias = _full_tree(tree, inertial)
    kinematics = _kinematics(full, inertias, _angles(tree, q))
    return _matrix_on_coordinates(
        tree,
        _full_mass_matrix(
            full, kinematics, _sum_over_carried(full, kinematics.body), _like(tree, inertial, q)
        ),
    )


def gravity_force(tree: Tree, inertial: Array, q: Array, gravity: Array) -> jax.Array:
    """Compute the force of gravity on each joint `[n, ...]`, N m or N: minus the bias force at
    rest.
    """
    return -inverse_dynamics(tree, inertial, q, None, None, gravity)


def inverse_dynamics(
    tree: Tree, inertial: Array, q: Array, v: Array | None, a: Array | None, gravity: Array
) -> jax.Array:
    """Compute the generalized forces `[n, ...]`, N m or N, that a motion `q, v, a: [n, ...]`
    requires, without armature; `v` or `a` None stands for 0.
    """
    q = jnp.asarray(q)
    full, inertias = _full_tree(tree, inertial)
    return _inverse_dynamics(tree, full, inertias, q, v, a, gravity)


def _inverse_dynamics(
    tree: Tree, full: Tree, inertias: Array, q: jax.Array, v: Any, a: Any, gravity: Array
) -> jax.Array:
    """Compute the forces that all joints `full` with inertial parameters `inertias` require, on the
    coordinates of `tree`.
    """
    kinematics = _kinematics(full, inertias, _angles(tree, q))
    gravity_lanes = with_batch_axes(gravity, 1, q.ndim - 1, q.dtype)
    wrench = _sum_over_carried(
        full, _body_motion(full, kinematics, _rates(tree, v), _rates(tree, a), gravity_lanes).wrench
    )
    like = _like(full, inertias, q, v, a, gravity)
    return _forces_on_coordinates(
        tree,
        jnp.broadcast_to(
            _filled(dot_pair(kinematics.screw, wrench), full.n, like), (full.n, *like.shape)
        ),
    )


def compensation(tree: Tree, q: Array) -> jax.Array | None:
    """Compute the force `[n, ...]` that holds declared shares of bodies up (MuJoCo's
    `qfrc_gravcomp`), N m or N; None where nothing is held up.
    """
    full = tree if tree.all_joints is None else tree.all_joints.tree
    if not any(full.compensated):
        return None
    held_up = replace(
        full,
        shapes=tuple(
            replace(shape, massless=not is_compensated)
            for shape, is_compensated in zip(full.shapes, full.compensated, strict=True)
        ),
    )
    return _inverse_dynamics(
        tree, held_up, jnp.asarray(full.gravcomp), jnp.asarray(q), None, None, tree.gravity
    )


def acceleration(
    tree: Tree, inertial: Array, q: Array, v: Array, force: Array, armature: Array, gravity: Array
) -> jax.Array:
    """Compute the joints' accelerations `[n, ...]`, rad/s^2 or m/s^2, at `q, v: [n, ...]` under the
    generalized `force: [n, ...]` (all but gravity and inertia).
    """
    q = jnp.asarray(q)
    like = _like(tree, inertial, q, v, force, armature, gravity)

    def broadcast(x):
        return jnp.broadcast_to(with_batch_axes(x, 1, q.ndim - 1, q.dtype), (tree.n, *like.shape))

    return _acceleration(
        tree, inertial, broadcast(q), broadcast(v), broadcast(force), broadcast(armature), gravity
    )


def inverse_mass(tree: Tree, inertial: Array, q: Array, armature: Array) -> jax.Array:
    """Invert the mass matrix with armature, `[n, n, ...]`; column j is the acceleration that a unit
    force at joint j brings.
    """
    q = jnp.asarray(q)
    like = _like(tree, inertial, q, armature)

    def broadcast(x):
        return jnp.broadcast_to(with_batch_axes(x, 1, q.ndim - 1, q.dtype), (tree.n, *like.shape))

    return _inverse_mass(tree, inertial, broadcast(q), broadcast(armature))


def regressor(tree: Tree, q: Array, v: Array | None, a: Array | None, gravity: Array) -> jax.Array:
    """Compute the regressor `[n, 10 n, ...]`: inverse dynamics are `regressor @ inertial.ravel()`
    (Atkeson, An and Hollerbach, 1986).
    """
    q = jnp.asarray(q)
    like = _like(tree, None, q, v, a, gravity)
    full, _ = _full_tree(tree, None)
    kinematics = _kinematics(full, None, _angles(tree, q))
    motion = _body_motion(
        full,
        kinematics,
        _rates(tree, v),
        _rates(tree, a),
        with_batch_axes(gravity, 1, q.ndim - 1, q.dtype),
    )
    rotation, origin = kinematics.pose
    omega, u = (apply_transposed(rotation, x) for x in _about(motion.velocity, origin))
    alpha, linear = (apply_transposed(rotation, x) for x in _about(motion.acceleration, origin))
    linear = plus(
        linear, cross(omega, u)
    )  # of the point of the body, where the spatial one is of the place

    def pair(x):
        return tuple(y if is_static(y) else y[None] for y in x)  # of body j, for each joint i

    axes = tuple(pair(row) for row in rotation)
    angular, along = (tuple(y if is_static(y) else y[:, None] for y in x) for x in kinematics.screw)
    turn, push = (apply_transposed(axes, x) for x in _about((angular, along), pair(origin)))
    carried = _mask(_ancestry(full) & ~np.array(full.massless)[None], like)
    own_joints = slice(None) if tree.all_joints is None else np.array(tree.all_joints.own)
    columns = []
    for force, moment in _body_regressor(pair(omega), pair(alpha), pair(linear)):
        table = _table(add(dot(push, force), dot(turn, moment)), full.n, like) * carried
        columns.append(_forces_on_coordinates(tree, table)[:, own_joints])
    out = jnp.stack(columns, 2)  # [i, j, 10, ...]
    return out.reshape(tree.n, 10 * tree.n, *like.shape)


def solve(mass: Array, rhs: Array) -> jax.Array:
    """Solve `mass x = rhs` for x `[n, ...]`: `mass [n, n, ...]`, symmetric and positive definite,
    and `rhs [n, ...]`.
    """
    mass, rhs = jnp.asarray(mass), jnp.asarray(rhs)
    return _substitute(_factorise(mass), rhs[:, None])[:, 0]


def _full_tree(tree: Tree, inertial: Any, is_tangent: bool = False) -> tuple[Tree, Any]:
    """Return the tree of all joints, and the inertial parameters [m, 10, ...] of all bodies with
    those of the coordinates' own in their place.

    Args:
        is_tangent: Whether `inertial` is a tangent, of which followers have none.
    """
    if tree.all_joints is None:
        return tree, inertial
    full, own_joints = tree.all_joints.tree, np.array(tree.all_joints.own)
    if inertial is None:
        return full, None
    own_inertias = jnp.asarray(inertial)
    inertias = with_batch_axes(full.inertial, 2, own_inertias.ndim - 2, own_inertias.dtype)
    inertias = jnp.broadcast_to(
        0.0 * inertias if is_tangent else inertias, (full.n, *own_inertias.shape[1:])
    )
    return full, inertias.at[own_joints].set(own_inertias)


def _angles(tree: Tree, q: jax.Array) -> jax.Array:
    """Compute positions `[m, ...]` of all joints at the coordinates `q: [n, ...]`."""
    if tree.all_joints is None:
        return q
    factor, offset = (
        with_batch_axes(x, 1, q.ndim - 1, q.dtype)
        for x in (tree.all_joints.factor, tree.all_joints.offset)
    )
    return offset + factor * q[np.array(tree.all_joints.leader)]


def _rates(tree: Tree, v: Any) -> Any:
    """Compute speeds or accelerations `[m, ...]` of all joints from the coordinates' `[n, ...]`
    (None: 0).
    """
    if tree.all_joints is None or v is None:
        return v
    v = jnp.asarray(v)
    return (
        with_batch_axes(tree.all_joints.factor, 1, v.ndim - 1, v.dtype)
        * v[np.array(tree.all_joints.leader)]
    )


def _forces_on_coordinates(tree: Tree, x: jax.Array) -> jax.Array:
    """Project forces `[m, ...]` on all joints to the coordinates, `[n, ...]`."""
    if tree.all_joints is None:
        return x
    scaled = with_batch_axes(tree.all_joints.factor, 1, x.ndim - 1, x.dtype) * x
    leaders = tree.all_joints.leader
    return jnp.stack(
        [sum(scaled[k] for k, leader in enumerate(leaders) if leader == j) for j in range(tree.n)]
    )


def _matrix_on_coordinates(tree: Tree, x: jax.Array) -> jax.Array:
    """Project a matrix `[m, m, ...]` of forces by motions of all joints to the coordinates,
    `[n, n, ...]`.
    """
    if tree.all_joints is None:
        return x
    return jnp.swapaxes(
        _forces_on_coordinates(tree, jnp.swapaxes(_forces_on_coordinates(tree, x), 0, 1)), 0, 1
    )


def _like(tree: Tree, inertial: Any, q: jax.Array, *others: Any) -> jax.Array:
    """Zeros of the batch's shape: what all arguments have behind their own axes."""
    lanes = (q, *others, tree.place[:, 0], tree.gravity)
    shapes = [jnp.shape(x)[1:] for x in lanes if x is not None]
    shapes += [] if inertial is None else [jnp.shape(inertial)[2:]]
    return jnp.zeros(jnp.broadcast_shapes(*shapes), q.dtype)


def _mask(mask: np.ndarray, like: jax.Array) -> jax.Array:
    """Ones and zeros, with an axis of one for each of the batch's."""
    return jnp.asarray(mask, like.dtype).reshape(*mask.shape, *(1,) * like.ndim)


def _filled(x: Entry, n: int, like: jax.Array) -> jax.Array:
    """An entry as an array `[n, ...]`."""
    return jnp.broadcast_to(jnp.asarray(x, like.dtype), (n, *like.shape))


def _table(x: Entry, n: int, like: jax.Array) -> jax.Array:
    """An entry as an array `[n, n, ...]`."""
    return jnp.broadcast_to(jnp.asarray(x, like.dtype), (n, n, *like.shape))


def _ancestry(tree: Tree) -> np.ndarray:
    """[n, n]: whether joint i carries body j, which it does its own."""
    out = np.eye(tree.n, dtype=bool)
    for j in range(tree.n):
        out[list(ancestors(tree, j)), j] = True
    return out


def _about(motion: Pair, point: Vector) -> Pair:
    """Express a motion about another point."""
    return motion[0], plus(motion[1], cross(motion[0], point))


def _kinematics(tree: Tree, inertial: Any, q: jax.Array) -> Kinematics:
    """Compute what `q` decides; bodies weigh nothing where `inertial` is None."""
    pose = stack_poses(chain(tree, q), _like(tree, None, q))
    pose = _evaluate_once(pose, q)
    hinge = np.array([kind == "hinge" for kind in tree.kinds])
    axis = pose.axis
    if hinge.all():
        screw = axis, cross(pose.origin, axis)
    elif not hinge.any():
        screw = ZERO, axis
    else:
        turns = _mask(hinge, _like(tree, None, q))
        moment = cross(pose.origin, axis)
        angular = times(turns, axis)
        linear = tuple(
            add(mul(turns, m), mul(1.0 - turns, z)) for m, z in zip(moment, axis, strict=True)
        )
        screw = angular, linear
    if inertial is None:
        return Kinematics(pose, screw, InertialBody(0, ZERO, (ZERO, ZERO, ZERO)))
    inertias = with_batch_axes(inertial, 2, q.ndim - 1, q.dtype)
    if any(tree.massless):
        inertias = inertias * _mask(~np.array(tree.massless), inertias[0])
    mass, x, y, z, *six = (inertias[:, k] for k in range(10))
    return Kinematics(
        pose,
        screw,
        move_reference(rotate_body(pose.rotation, mass, (x, y, z), symmetric(*six)), pose.origin),
    )


def _body_motion(
    tree: Tree, kinematics: Kinematics, v: Array | None, a: Array | None, gravity: jax.Array
) -> BodyMotion:
    """Compute the motion of each body and the wrench it needs, under `gravity [3, ...]`."""
    no_motion: Pair = (ZERO, ZERO)
    batch = gravity.ndim - 1
    if v is None:
        joint_velocity = no_motion
    else:
        joint_velocity = times_pair(with_batch_axes(v, 1, batch, gravity.dtype), kinematics.screw)
    velocity = _sum_over_carriers(tree, joint_velocity)
    joint_acceleration = cross_motion(velocity, joint_velocity)
    if a is not None:
        joint_acceleration = plus_pair(
            joint_acceleration,
            times_pair(with_batch_axes(a, 1, batch, gravity.dtype), kinematics.screw),
        )
    acceleration = _sum_over_carriers(tree, joint_acceleration)
    acceleration = (
        acceleration[0],
        tuple(sub(x, g[None]) for x, g in zip(acceleration[1], gravity, strict=True)),
    )
    wrench = plus_pair(
        momentum(kinematics.body, acceleration),
        cross_wrench(velocity, momentum(kinematics.body, velocity)),
    )

    def minus_joint(pair, joint):
        return (minus(pair[0], joint[0]), minus(pair[1], joint[1]))

    return BodyMotion(
        velocity,
        acceleration,
        minus_joint(velocity, joint_velocity),
        minus_joint(acceleration, joint_acceleration),
        wrench,
    )


def _evaluate_once(values: Any, primal: jax.Array) -> Any:
    """Compute the arrays among the entries here, once, and not in each place that uses them (see
    `once`); `primal` is what they are computed from.
    """
    leaves, structure = jax.tree.flatten(values)
    arrays = [x for x in leaves if not is_static(x)]
    if not arrays or primal.size == 0:
        return values
    evaluated = iter(once(arrays, primal))
    return jax.tree.unflatten(structure, [x if is_static(x) else next(evaluated) for x in leaves])


def _sum_over_carriers(tree: Tree, values: Any) -> Any:
    """Sum values for each joint over the joints that carry it and itself."""

    def run(rows: list[jax.Array]) -> list[jax.Array]:
        for i, p in enumerate(tree.parent):
            rows[i] = rows[i] if p < 0 else rows[i] + rows[p]
        return rows

    return _accumulate(tree, values, run)


def _sum_over_carried(tree: Tree, values: Any) -> Any:
    """Sum values for each joint over the bodies that it carries."""

    def run(rows: list[jax.Array]) -> list[jax.Array]:
        for i in reversed(range(tree.n)):
            if (p := tree.parent[i]) >= 0:
                rows[p] = rows[p] + rows[i]
        return rows

    return _accumulate(tree, values, run)


def _accumulate(tree: Tree, values: Any, run: Any) -> Any:
    leaves, structure = jax.tree.flatten(values)
    arrays = [x for x in leaves if not is_static(x)]  # a known entry of what is summed is a zero
    if not arrays:
        return values
    shape = (tree.n, *jnp.broadcast_shapes(*(x.shape for x in arrays))[1:])
    lanes = jnp.stack([jnp.broadcast_to(x, shape) for x in arrays])
    accumulated = jnp.stack(run([lanes[:, i] for i in range(tree.n)]), 1)
    sums = iter(list(accumulated))
    return jax.tree.unflatten(structure, [x if is_static(x) else next(sums) for x in leaves])


def _outer(a: Pair, b: Pair) -> Entry:
    """`[n, n, ...]`: of wrenches or motions `a` of joints i with `b` of joints j."""
    out: Entry = 0
    for x, y in zip((*a[0], *a[1]), (*b[0], *b[1]), strict=True):
        out = add(out, mul(x if is_static(x) else x[:, None], y if is_static(y) else y[None]))
    return out


def _full_mass_matrix(
    tree: Tree, kinematics: Kinematics, composite: InertialBody, like: jax.Array
) -> jax.Array:
    """Compute the mass matrix of all joints; `composite`: for each joint all that it carries, as
    one body.
    """
    lower = _table(
        _outer(momentum(composite, kinematics.screw), kinematics.screw), tree.n, like
    )  # right where joint j carries joint i
    carries = _ancestry(tree)
    strictly = carries & ~np.eye(tree.n, dtype=bool)
    below = lower * _mask(carries.T, like)
    return below + jnp.swapaxes(lower, 0, 1) * _mask(strictly, like)


def _derivatives(
    tree: Tree, kinematics: Kinematics, q: jax.Array, v: Any, a: Any, gravity: Any, like: jax.Array
) -> tuple[jax.Array, jax.Array]:
    motion = _body_motion(tree, kinematics, v, a, with_batch_axes(gravity, 1, q.ndim - 1, q.dtype))
    screw = kinematics.screw
    swing = cross_motion(motion.velocity_before, screw)
    surge = plus_pair(
        cross_motion(motion.acceleration_before, screw), cross_motion(motion.velocity_before, swing)
    )
    composite, wrench, (spin, push) = _sum_over_carried(
        tree, (kinematics.body, motion.wrench, swirl(kinematics.body, motion.velocity))
    )

    def swirled(m: Pair) -> Pair:
        return apply(spin, m[0]), times(2.0, cross(m[0], push))

    wrench_by_q = plus_pair(
        plus_pair(momentum(composite, surge), swirled(swing)), cross_wrench(screw, wrench)
    )
    wrench_by_v = plus_pair(times_pair(2.0, momentum(composite, swing)), swirled(screw))
    joint_momentum = momentum(composite, screw)
    back = plus(apply_transposed(spin, screw[0]), times(2.0, cross(push, screw[1]))), ZERO
    carries = _ancestry(tree)
    upper, lower = _mask(carries, like), _mask((carries & ~np.eye(tree.n, dtype=bool)).T, like)

    def table(x):
        return _table(x, tree.n, like)

    by_q = upper * table(_outer(screw, wrench_by_q))
    by_q = by_q + lower * table(add(_outer(joint_momentum, surge), _outer(back, swing)))
    by_v = upper * table(_outer(screw, wrench_by_v))
    by_v = by_v + lower * table(add(mul(2.0, _outer(joint_momentum, swing)), _outer(back, screw)))
    return by_q, by_v


def _body_regressor(w: Vector, dw: Vector, a: Vector) -> list[tuple[Vector, Vector]]:
    """Force and moment about the origin, in the body's own axes, for one unit of each inertial
    parameter.

    Args:
        a: Of the origin.
    """
    out: list[tuple[Vector, Vector]] = [(a, ZERO)]
    for unit in IDENTITY:
        out.append((plus(cross(dw, unit), cross(w, cross(w, unit))), cross(unit, a)))
    for r, c in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
        spun: list[Entry] = list(ZERO)
        sped: list[Entry] = list(ZERO)
        for i, j in {(r, c), (c, r)}:
            spun[i], sped[i] = w[j], dw[j]
        out.append((ZERO, plus(sped, cross(w, spun))))
    return out


Factor = tuple[list[jax.Array], list[jax.Array]]


def _factorise(mass: jax.Array) -> Factor:
    """Factorise M = L' D L with L unit lower triangular: rows of L `[k, ...]`, and 1 / D."""
    rows, inverse = [], []
    for k in reversed(range(mass.shape[0])):
        inverse.append(1.0 / mass[k, k])
        rows.append(mass[k, :k] * inverse[-1][None])
        mass = mass[:k, :k] - rows[-1][:, None] * mass[k, :k][None]
    return rows[::-1], inverse[::-1]


def _substitute(factor: Factor, rhs: jax.Array) -> jax.Array:
    """Solve for right-hand sides `[n, m, ...]` by the factors."""
    rows, inverse = factor
    n = len(rows)
    scaled: list[Any] = [None] * n
    for k in reversed(range(n)):
        scaled[k] = rhs[k] * inverse[k][None]
        rhs = rhs[:k] - rows[k][:, None] * rhs[k][None]
    out: list[jax.Array] = []
    for k in range(n):
        row = scaled[k]
        if k:
            row = row - sum(rows[k][i][None] * out[i] for i in range(k))
        out.append(row)
    return jnp.stack(out)


def _invert(mass: jax.Array) -> jax.Array:
    n = mass.shape[0]
    eye = jnp.eye(n, dtype=mass.dtype).reshape(n, n, *(1,) * (mass.ndim - 2))
    return _substitute(_factorise(mass), jnp.broadcast_to(eye, mass.shape))


def _with_armature(mass: jax.Array, armature: jax.Array) -> jax.Array:
    n = mass.shape[0]
    identity = jnp.eye(n, dtype=mass.dtype).reshape(n, n, *(1,) * (mass.ndim - 2))
    return mass + identity * armature[None]


def _times_rows(m: Array, x: Array) -> Array:
    """`[n, k, ...] @ [k, ...]`."""
    return sum(m[:, j] * x[j][None] for j in range(m.shape[1]))


@jax.custom_jvp
def _acceleration(tree, inertial, q, v, force, armature, gravity):
    return _solve_acceleration(tree, inertial, q, v, force, armature, gravity)


def _solve_acceleration(tree, inertial, q, v, force, armature, gravity):
    full, inertias = _full_tree(tree, inertial)
    _, mass, bias = _mass_and_bias(tree, full, inertias, q, v, armature, gravity)
    return solve(mass, force - bias)


def _mass_and_bias(tree, full, inertias, q, v, armature, gravity):
    """Return kinematics of all joints, mass matrix with armature and bias force of the
    coordinates.
    """
    kinematics = _kinematics(full, inertias, _angles(tree, q))
    motion = _body_motion(
        full, kinematics, _rates(tree, v), None, with_batch_axes(gravity, 1, q.ndim - 1, q.dtype)
    )
    composite, wrench = _sum_over_carried(full, (kinematics.body, motion.wrench))
    mass = _with_armature(
        _matrix_on_coordinates(tree, _full_mass_matrix(full, kinematics, composite, q[0])), armature
    )
    return (
        kinematics,
        mass,
        _forces_on_coordinates(tree, _filled(dot_pair(kinematics.screw, wrench), full.n, q[0])),
    )


def _acceleration_jvp(primals, tangents):
    """From M a + bias = force: da = M^-1 (dforce - d(inverse dynamics at a) - darmature a). The
    partial derivatives do not depend on the direction, so under `vmap` over directions they are
    computed once.
    """
    tree, inertial, q, v, force, armature, gravity = primals
    d_tree, d_inertial, d_q, d_v, d_force, d_armature, d_gravity = tangents
    full, inertias = _full_tree(tree, inertial)
    kinematics, mass, bias = _mass_and_bias(tree, full, inertias, q, v, armature, gravity)
    inverse = _invert(mass)
    a = _times_rows(inverse, force - bias)
    by_q, by_v = _derivatives(full, kinematics, q, _rates(tree, v), _rates(tree, a), gravity, q[0])
    by_q, by_v = _matrix_on_coordinates(tree, by_q), _matrix_on_coordinates(tree, by_v)
    a, inverse, by_q, by_v = _evaluate_once((a, inverse, by_q, by_v), q)
    force_changes = [
        d_force,
        None if _is_zero(d_q) else -_times_rows(by_q, d_q),
        None if _is_zero(d_v) else -_times_rows(by_v, d_v),
        None if _is_zero(d_armature) else -d_armature * a,
    ]
    if not _is_zero(d_inertial):
        full, d_inertias = _full_tree(tree, d_inertial, True)
        force_changes.append(-_inverse_dynamics(tree, full, d_inertias, q, v, a, gravity))
    if not _is_zero(d_gravity):
        force_changes.append(gravity_force(tree, inertial, q, d_gravity))
    force_changes = [x for x in force_changes if x is not None and not _is_zero(x)]
    if force_changes:
        change = _times_rows(inverse, sum(force_changes))
    else:
        change = jnp.zeros_like(a)
    if not all(map(_is_zero, jax.tree.leaves(d_tree, is_leaf=_is_zero))):

        def acceleration_of(tree):
            return _solve_acceleration(tree, inertial, q, v, force, armature, gravity)

        change = change + jax.jvp(acceleration_of, (tree,), (_instantiate_zeros(d_tree),))[1]
    return a, change


def _is_zero(tangent: Any) -> bool:
    return isinstance(tangent, jax.custom_derivatives.SymbolicZero)


def _instantiate_zeros(tangents: Any) -> Any:
    def fill(x):
        if _is_zero(x):
            return jnp.zeros(x.shape, x.dtype)
        return x

    return jax.tree.map(fill, tangents, is_leaf=_is_zero)


_acceleration.defjvp(_acceleration_jvp, symbolic_zeros=True)


@jax.custom_jvp
def _inverse_mass(tree, inertial, q, armature):
    return _invert(_with_armature(mass_matrix(tree, inertial, q), armature))


def _inverse_mass_jvp(primals, tangents):
    tree, inertial, q, armature = primals
    d_tree, d_inertial, d_q, d_armature = tangents
    full, inertias = _full_tree(tree, inertial)
    kinematics = _kinematics(full, inertias, _angles(tree, q))
    composite = _sum_over_carried(full, kinematics.body)
    inverse = _invert(
        _with_armature(
            _matrix_on_coordinates(tree, _full_mass_matrix(full, kinematics, composite, q[0])),
            armature,
        )
    )
    by_q = None
    if not _is_zero(d_q):  # [i, j, k]: by the angle k
        cube = jnp.moveaxis(_mass_by_q(full, kinematics, composite, q[0]), 2, 0)
        by_q = jnp.moveaxis(
            jax.vmap(lambda z: _matrix_on_coordinates(tree, z))(_forces_on_coordinates(tree, cube)),
            0,
            2,
        )
    inverse, by_q = _evaluate_once((inverse, by_q), q)
    change = jnp.zeros_like(inverse)
    if by_q is not None:
        change = change + sum(by_q[:, :, k] * d_q[k][None, None] for k in range(tree.n))
    if not _is_zero(d_armature):
        change = _with_armature(change, d_armature)
    if not _is_zero(d_inertial):
        full, d_inertias = _full_tree(tree, d_inertial, True)
        tangent_bodies = _kinematics(full, d_inertias, _angles(tree, q))
        change = change + _matrix_on_coordinates(
            tree,
            _full_mass_matrix(
                full, tangent_bodies, _sum_over_carried(full, tangent_bodies.body), q[0]
            ),
        )
    if not all(map(_is_zero, jax.tree.leaves(d_tree, is_leaf=_is_zero))):
        change = (
            change
            + jax.jvp(
                lambda tree: mass_matrix(tree, inertial, q), (tree,), (_instantiate_zeros(d_tree),)
            )[1]
        )

    def product(a: Array, b: Array) -> Array:
        return sum(a[:, k][:, None] * b[k][None] for k in range(tree.n))

    return inverse, -product(inverse, product(change, inverse))


_inverse_mass.defjvp(_inverse_mass_jvp, symbolic_zeros=True)


def _mass_by_q(
    tree: Tree, kinematics: Kinematics, composite: InertialBody, like: jax.Array
) -> jax.Array:
    """Differentiate the mass matrix `[n, n, n, ...]`: entry i, j by the angle k. Only what lies
    between two joints, or is carried by both, changes it: with j carrying i, either k is between
    (then joint j's screw turns against the rest), or i carries k.
    """
    n, carries, eye = tree.n, _ancestry(tree), np.eye(tree.n, dtype=bool)

    def at(pair: Pair, axes: str) -> Pair:
        """Entries with the axes `axes`, in that order, on the axes i, j, k."""
        missing = [axis for axis in "ijk" if axis not in axes]
        order = [(axes + "".join(missing)).index(axis) for axis in "ijk"]

        def spread(x):
            front, behind = x.shape[: len(axes)], x.shape[len(axes) :]
            return x.reshape(*front, *(1,) * len(missing), *behind)

        def place(x):
            if is_static(x):
                return x
            return jnp.transpose(spread(x), (*order, *range(3, spread(x).ndim)))

        return jax.tree.map(place, pair)

    def first(x):
        return jax.tree.map(lambda y: y if is_static(y) else y[:, None], x)

    def second(x):
        return jax.tree.map(lambda y: y if is_static(y) else y[None], x)

    turns = cross_motion(
        first(kinematics.screw), second(kinematics.screw)
    )  # [j, k]: screw j turned by joint k, less its sign
    pull = momentum(
        first(composite), second(kinematics.screw)
    )  # [k, i]: what joint k carries, moved by joint i
    between = dot_pair(at(momentum(composite, kinematics.screw), "i"), at(turns, "jk"))
    carried = add(
        dot_pair(at(turns, "jk"), at(pull, "ki")), dot_pair(at(pull, "kj"), at(turns, "ik"))
    )
    below, strictly = carries.T, carries.T & ~eye  # [i, j]: joint j carries joint i
    in_between = (
        below[:, :, None] & strictly.T[None] & below[:, None, :]
    )  # j above k, and k carries i
    further = below[:, :, None] & strictly.T[:, None, :]  # i above k

    def cube(x, mask):
        cells = jnp.broadcast_to(jnp.asarray(x, like.dtype), (n, n, n, *like.shape))
        return cells * _mask(mask, like)

    lower = cube(between, in_between) + cube(carried, further)
    return lower + jnp.swapaxes(lower, 0, 1) * _mask(~eye, like)[:, :, None]
