"""Dynamics of a `Tree`: mass matrix, bias force, regressor, acceleration with its derivatives,
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
end; `inertial` is of the coordinates' own bodies, followers keep theirs.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core.trig import once
from adaptsim_jax.mechanisms.kinematics import Pose, chain, lifted, together
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
    known,
    minus,
    momentum,
    moved,
    mul,
    plus,
    plus_pair,
    sub,
    swirl,
    symmetric,
    times,
    times_pair,
    turned,
)
from adaptsim_jax.mechanisms.tree import Tree, ancestors

Array = Any


class Still(NamedTuple):
    """What positions alone decide: poses, the motion that each joint makes at unit speed, and the
    bodies.
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
    """`[n, n, ...]` kg m^2 (kg m, kg where slides are concerned) at `q: [n, ...]`, without
    armature.
    """
    q = jnp.asarray(q)
    whole, rows = _wholly(tree, inertial)
    still = _still(whole, rows, _angles(tree, q))
    return _on_both(tree, _mass(whole, still, _up(whole, still.body), _like(tree, inertial, q)))


def gravity_force(tree: Tree, inertial: Array, q: Array, gravity: Array) -> jax.Array:
    """`[n, ...]`: what gravity does to each joint, minus the bias force at rest."""
    return -inverse_dynamics(tree, inertial, q, None, None, gravity)


def inverse_dynamics(
    tree: Tree, inertial: Array, q: Array, v: Array | None, a: Array | None, gravity: Array
) -> jax.Array:
    """`[n, ...]`: generalized forces that make `q, v, a: [n, ...]` come about, without armature;
    `v` or `a` None stands for 0.
    """
    q = jnp.asarray(q)
    whole, rows = _wholly(tree, inertial)
    return _inverse_dynamics(tree, whole, rows, q, v, a, gravity)


def _inverse_dynamics(
    tree: Tree, whole: Tree, rows: Array, q: jax.Array, v: Any, a: Any, gravity: Array
) -> jax.Array:
    """Of all joints `whole` with inertial parameters `rows`, brought to the coordinates of
    `tree`.
    """
    still = _still(whole, rows, _angles(tree, q))
    down = lifted(gravity, 1, q.ndim - 1, q.dtype)
    wrench = _up(whole, _moving(whole, still, _rates(tree, v), _rates(tree, a), down).wrench)
    like = _like(whole, rows, q, v, a, gravity)
    return _on_one(
        tree,
        jnp.broadcast_to(
            _filled(dot_pair(still.screw, wrench), whole.n, like), (whole.n, *like.shape)
        ),
    )


def compensation(tree: Tree, q: Array) -> jax.Array | None:
    """`[n, ...]`: the force that holds declared shares of bodies up (MuJoCo's `qfrc_gravcomp`);
    None where nothing does.
    """
    every = tree if tree.whole is None else tree.whole.tree
    if not any(every.compensated):
        return None
    bare = replace(
        every,
        shapes=tuple(
            replace(shape, massless=not on)
            for shape, on in zip(every.shapes, every.compensated, strict=True)
        ),
    )
    return _inverse_dynamics(
        tree, bare, jnp.asarray(every.gravcomp), jnp.asarray(q), None, None, tree.gravity
    )


def acceleration(
    tree: Tree, inertial: Array, q: Array, v: Array, force: Array, armature: Array, gravity: Array
) -> jax.Array:
    """`[n, ...]`: of the joints at `q, v: [n, ...]` under the generalized `force: [n, ...]` (all
    but gravity and inertia).
    """
    q = jnp.asarray(q)
    like = _like(tree, inertial, q, v, force, armature, gravity)

    def wide(x):
        return jnp.broadcast_to(lifted(x, 1, q.ndim - 1, q.dtype), (tree.n, *like.shape))

    return _acceleration(tree, inertial, wide(q), wide(v), wide(force), wide(armature), gravity)


def inverse_mass(tree: Tree, inertial: Array, q: Array, armature: Array) -> jax.Array:
    """`[n, n, ...]`: of the mass matrix with armature; column j is the acceleration that a unit
    force at joint j brings.
    """
    q = jnp.asarray(q)
    like = _like(tree, inertial, q, armature)

    def wide(x):
        return jnp.broadcast_to(lifted(x, 1, q.ndim - 1, q.dtype), (tree.n, *like.shape))

    return _inverse_mass(tree, inertial, wide(q), wide(armature))


def regressor(tree: Tree, q: Array, v: Array | None, a: Array | None, gravity: Array) -> jax.Array:
    """`[n, 10 n, ...]`: inverse dynamics are `regressor @ inertial.ravel()` (Atkeson, An and
    Hollerbach, 1986).
    """
    q = jnp.asarray(q)
    like = _like(tree, None, q, v, a, gravity)
    whole, _ = _wholly(tree, None)
    still = _still(whole, None, _angles(tree, q))
    moving = _moving(
        whole, still, _rates(tree, v), _rates(tree, a), lifted(gravity, 1, q.ndim - 1, q.dtype)
    )
    rotation, origin = still.pose
    omega, u = (apply_transposed(rotation, x) for x in _about(moving.velocity, origin))
    alpha, linear = (apply_transposed(rotation, x) for x in _about(moving.acceleration, origin))
    linear = plus(
        linear, cross(omega, u)
    )  # of the point of the body, where the spatial one is of the place

    def pair(x):
        return tuple(y if known(y) else y[None] for y in x)  # of body j, for each joint i

    axes = tuple(pair(row) for row in rotation)
    angular, along = (tuple(y if known(y) else y[:, None] for y in x) for x in still.screw)
    turn, push = (apply_transposed(axes, x) for x in _about((angular, along), pair(origin)))
    carried = _mask(_ancestry(whole) & ~np.array(whole.massless)[None], like)
    own = slice(None) if tree.whole is None else np.array(tree.whole.own)
    columns = []
    for force, moment in _body_regressor(pair(omega), pair(alpha), pair(linear)):
        table = _table(add(dot(push, force), dot(turn, moment)), whole.n, like) * carried
        columns.append(_on_one(tree, table)[:, own])
    out = jnp.stack(columns, 2)  # [i, j, 10, ...]
    return out.reshape(tree.n, 10 * tree.n, *like.shape)


def solve(mass: Array, rhs: Array) -> jax.Array:
    """`[n, ...]`: `mass [n, n, ...]`, symmetric and positive definite, into `rhs [n, ...]`."""
    mass, rhs = jnp.asarray(mass), jnp.asarray(rhs)
    return _solved(_factored(mass), rhs[:, None])[:, 0]


def _wholly(tree: Tree, inertial: Any, change: bool = False) -> tuple[Tree, Any]:
    """The tree of all joints, and the inertial parameters of all bodies with those of the
    coordinates' own in their place.

    Args:
        change: These are tangents, so that followers, which stay as they are, have none.
    """
    if tree.whole is None:
        return tree, inertial
    every, own = tree.whole.tree, np.array(tree.whole.own)
    if inertial is None:
        return every, None
    mine = jnp.asarray(inertial)
    rows = lifted(every.inertial, 2, mine.ndim - 2, mine.dtype)
    rows = jnp.broadcast_to(0.0 * rows if change else rows, (every.n, *mine.shape[1:]))
    return every, rows.at[own].set(mine)


def _angles(tree: Tree, q: jax.Array) -> jax.Array:
    """`[m, ...]` of all joints at the coordinates `q: [n, ...]`."""
    if tree.whole is None:
        return q
    factor, offset = (
        lifted(x, 1, q.ndim - 1, q.dtype) for x in (tree.whole.factor, tree.whole.offset)
    )
    return offset + factor * q[np.array(tree.whole.leader)]


def _rates(tree: Tree, v: Any) -> Any:
    """Speeds or accelerations of all joints of those of the coordinates (None: 0)."""
    if tree.whole is None or v is None:
        return v
    v = jnp.asarray(v)
    return lifted(tree.whole.factor, 1, v.ndim - 1, v.dtype) * v[np.array(tree.whole.leader)]


def _on_one(tree: Tree, x: jax.Array) -> jax.Array:
    """Forces `[m, ...]` on all joints, as forces on the coordinates `[n, ...]`."""
    if tree.whole is None:
        return x
    scaled = lifted(tree.whole.factor, 1, x.ndim - 1, x.dtype) * x
    leaders = tree.whole.leader
    return jnp.stack(
        [sum(scaled[k] for k, own in enumerate(leaders) if own == j) for j in range(tree.n)]
    )


def _on_both(tree: Tree, x: jax.Array) -> jax.Array:
    """`[m, m, ...]` of forces by motions of all joints, as `[n, n, ...]` of the coordinates'."""
    if tree.whole is None:
        return x
    return jnp.swapaxes(_on_one(tree, jnp.swapaxes(_on_one(tree, x), 0, 1)), 0, 1)


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
    """The same motion, about another point."""
    return motion[0], plus(motion[1], cross(motion[0], point))


def _still(tree: Tree, inertial: Any, q: jax.Array) -> Still:
    """inertial None: bodies that weigh nothing."""
    pose = together(chain(tree, q), _like(tree, None, q))
    pose = _computed(pose, q)
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
        return Still(pose, screw, InertialBody(0, ZERO, (ZERO, ZERO, ZERO)))
    rows = lifted(inertial, 2, q.ndim - 1, q.dtype)
    if any(tree.massless):
        rows = rows * _mask(~np.array(tree.massless), rows[0])
    mass, x, y, z, *six = (rows[:, k] for k in range(10))
    return Still(
        pose, screw, moved(turned(pose.rotation, mass, (x, y, z), symmetric(*six)), pose.origin)
    )


def _moving(
    tree: Tree, still: Still, v: Array | None, a: Array | None, gravity: jax.Array
) -> BodyMotion:
    """gravity [3, ...]."""
    nothing: Pair = (ZERO, ZERO)
    batch = gravity.ndim - 1
    if v is None:
        along = nothing
    else:
        along = times_pair(lifted(v, 1, batch, gravity.dtype), still.screw)
    velocity = _down(tree, along)
    rate = cross_motion(velocity, along)
    if a is not None:
        rate = plus_pair(rate, times_pair(lifted(a, 1, batch, gravity.dtype), still.screw))
    acceleration = _down(tree, rate)
    acceleration = (
        acceleration[0],
        tuple(sub(x, g[None]) for x, g in zip(acceleration[1], gravity, strict=True)),
    )
    wrench = plus_pair(
        momentum(still.body, acceleration), cross_wrench(velocity, momentum(still.body, velocity))
    )

    def without(pair, own):
        return (minus(pair[0], own[0]), minus(pair[1], own[1]))

    return BodyMotion(
        velocity, acceleration, without(velocity, along), without(acceleration, rate), wrench
    )


def _computed(values: Any, asked: jax.Array) -> Any:
    """Arrays among the entries are computed here, once, and not in each place that uses them (see
    `once`).
    """
    leaves, kind = jax.tree.flatten(values)
    arrays = [x for x in leaves if not known(x)]
    if not arrays or asked.size == 0:
        return values
    done = iter(once(arrays, asked))
    return jax.tree.unflatten(kind, [x if known(x) else next(done) for x in leaves])


def _down(tree: Tree, values: Any) -> Any:
    """For each joint the sum over the joints that carry it and itself."""

    def run(rows: list[jax.Array]) -> list[jax.Array]:
        for i, p in enumerate(tree.parent):
            rows[i] = rows[i] if p < 0 else rows[i] + rows[p]
        return rows

    return _accumulated(tree, values, run)


def _up(tree: Tree, values: Any) -> Any:
    """For each joint the sum over the bodies that it carries."""

    def run(rows: list[jax.Array]) -> list[jax.Array]:
        for i in reversed(range(tree.n)):
            if (p := tree.parent[i]) >= 0:
                rows[p] = rows[p] + rows[i]
        return rows

    return _accumulated(tree, values, run)


def _accumulated(tree: Tree, values: Any, run: Any) -> Any:
    leaves, kind = jax.tree.flatten(values)
    arrays = [x for x in leaves if not known(x)]  # a known entry of what is summed is a zero
    if not arrays:
        return values
    shape = (tree.n, *jnp.broadcast_shapes(*(x.shape for x in arrays))[1:])
    whole = jnp.stack([jnp.broadcast_to(x, shape) for x in arrays])
    summed = jnp.stack(run([whole[:, i] for i in range(tree.n)]), 1)
    done = iter(list(summed))
    return jax.tree.unflatten(kind, [x if known(x) else next(done) for x in leaves])


def _outer(a: Pair, b: Pair) -> Entry:
    """`[n, n, ...]`: of wrenches or motions `a` of joints i with `b` of joints j."""
    out: Entry = 0
    for x, y in zip((*a[0], *a[1]), (*b[0], *b[1]), strict=True):
        out = add(out, mul(x if known(x) else x[:, None], y if known(y) else y[None]))
    return out


def _mass(tree: Tree, still: Still, whole: InertialBody, like: jax.Array) -> jax.Array:
    """whole: for each joint all that it carries, as one body."""
    lower = _table(
        _outer(momentum(whole, still.screw), still.screw), tree.n, like
    )  # right where joint j carries joint i
    carries = _ancestry(tree)
    strictly = carries & ~np.eye(tree.n, dtype=bool)
    below = lower * _mask(carries.T, like)
    return below + jnp.swapaxes(lower, 0, 1) * _mask(strictly, like)


def _derivatives(
    tree: Tree, still: Still, q: jax.Array, v: Any, a: Any, gravity: Any, like: jax.Array
) -> tuple[jax.Array, jax.Array]:
    moving = _moving(tree, still, v, a, lifted(gravity, 1, q.ndim - 1, q.dtype))
    screw = still.screw
    swing = cross_motion(moving.velocity_before, screw)
    surge = plus_pair(
        cross_motion(moving.acceleration_before, screw), cross_motion(moving.velocity_before, swing)
    )
    whole, wrench, (spin, push) = _up(
        tree, (still.body, moving.wrench, swirl(still.body, moving.velocity))
    )

    def swirled(m: Pair) -> Pair:
        return apply(spin, m[0]), times(2.0, cross(m[0], push))

    above = plus_pair(
        plus_pair(momentum(whole, surge), swirled(swing)), cross_wrench(screw, wrench)
    )
    above_v = plus_pair(times_pair(2.0, momentum(whole, swing)), swirled(screw))
    own = momentum(whole, screw)
    back = plus(apply_transposed(spin, screw[0]), times(2.0, cross(push, screw[1]))), ZERO
    carries = _ancestry(tree)
    upper, lower = _mask(carries, like), _mask((carries & ~np.eye(tree.n, dtype=bool)).T, like)

    def table(x):
        return _table(x, tree.n, like)

    by_q = upper * table(_outer(screw, above))
    by_q = by_q + lower * table(add(_outer(own, surge), _outer(back, swing)))
    by_v = upper * table(_outer(screw, above_v))
    by_v = by_v + lower * table(add(mul(2.0, _outer(own, swing)), _outer(back, screw)))
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


def _factored(mass: jax.Array) -> Factor:
    """Of M = L' D L with L unit lower triangular: rows of L `[k, ...]`, and 1 / D."""
    rows, inverse = [], []
    for k in reversed(range(mass.shape[0])):
        inverse.append(1.0 / mass[k, k])
        rows.append(mass[k, :k] * inverse[-1][None])
        mass = mass[:k, :k] - rows[-1][:, None] * mass[k, :k][None]
    return rows[::-1], inverse[::-1]


def _solved(factor: Factor, rhs: jax.Array) -> jax.Array:
    """`[n, m, ...]` of right-hand sides `[n, m, ...]`."""
    rows, inverse = factor
    n = len(rows)
    scaled: list[Any] = [None] * n
    for k in reversed(range(n)):
        scaled[k] = rhs[k] * inverse[k][None]
        rhs = rhs[:k] - rows[k][:, None] * rhs[k][None]
    out: list[jax.Array] = []
    for k in range(n):
        solved = scaled[k]
        if k:
            solved = solved - sum(rows[k][i][None] * out[i] for i in range(k))
        out.append(solved)
    return jnp.stack(out)


def _inverted(mass: jax.Array) -> jax.Array:
    n = mass.shape[0]
    eye = jnp.eye(n, dtype=mass.dtype).reshape(n, n, *(1,) * (mass.ndim - 2))
    return _solved(_factored(mass), jnp.broadcast_to(eye, mass.shape))


def _with_armature(mass: jax.Array, armature: jax.Array) -> jax.Array:
    n = mass.shape[0]
    identity = jnp.eye(n, dtype=mass.dtype).reshape(n, n, *(1,) * (mass.ndim - 2))
    return mass + identity * armature[None]


def _times_rows(m: Array, x: Array) -> Array:
    """`[n, k, ...] @ [k, ...]`."""
    return sum(m[:, j] * x[j][None] for j in range(m.shape[1]))


@jax.custom_jvp
def _acceleration(tree, inertial, q, v, force, armature, gravity):
    return _accelerated(tree, inertial, q, v, force, armature, gravity)


def _accelerated(tree, inertial, q, v, force, armature, gravity):
    whole, rows = _wholly(tree, inertial)
    _, mass, bias = _mass_and_bias(tree, whole, rows, q, v, armature, gravity)
    return solve(mass, force - bias)


def _mass_and_bias(tree, every, rows, q, v, armature, gravity):
    """(Still of all joints, mass matrix with armature and bias force of the coordinates)."""
    still = _still(every, rows, _angles(tree, q))
    moving = _moving(every, still, _rates(tree, v), None, lifted(gravity, 1, q.ndim - 1, q.dtype))
    whole, wrench = _up(every, (still.body, moving.wrench))
    mass = _with_armature(_on_both(tree, _mass(every, still, whole, q[0])), armature)
    return still, mass, _on_one(tree, _filled(dot_pair(still.screw, wrench), every.n, q[0]))


def _acceleration_jvp(primals, tangents):
    """From M a + bias = force: da = M^-1 (dforce - d(inverse dynamics at a) - darmature a). The
    partial derivatives do not depend on the direction, so under `vmap` over directions they are
    computed once.
    """
    tree, inertial, q, v, force, armature, gravity = primals
    d_tree, d_inertial, d_q, d_v, d_force, d_armature, d_gravity = tangents
    every, rows = _wholly(tree, inertial)
    still, mass, bias = _mass_and_bias(tree, every, rows, q, v, armature, gravity)
    inverse = _inverted(mass)
    a = _times_rows(inverse, force - bias)
    by_q, by_v = _derivatives(every, still, q, _rates(tree, v), _rates(tree, a), gravity, q[0])
    by_q, by_v = _on_both(tree, by_q), _on_both(tree, by_v)
    a, inverse, by_q, by_v = _computed((a, inverse, by_q, by_v), q)
    missing = [
        d_force,
        None if _zero(d_q) else -_times_rows(by_q, d_q),
        None if _zero(d_v) else -_times_rows(by_v, d_v),
        None if _zero(d_armature) else -d_armature * a,
    ]
    if not _zero(d_inertial):
        d_every, d_rows = _wholly(tree, d_inertial, True)
        missing.append(-_inverse_dynamics(tree, d_every, d_rows, q, v, a, gravity))
    if not _zero(d_gravity):
        missing.append(gravity_force(tree, inertial, q, d_gravity))
    missing = [x for x in missing if x is not None and not _zero(x)]
    if missing:
        change = _times_rows(inverse, sum(missing))
    else:
        change = jnp.zeros_like(a)
    if not all(map(_zero, jax.tree.leaves(d_tree, is_leaf=_zero))):

        def along(tree):
            return _accelerated(tree, inertial, q, v, force, armature, gravity)

        change = change + jax.jvp(along, (tree,), (_made(d_tree),))[1]
    return a, change


def _zero(tangent: Any) -> bool:
    return isinstance(tangent, jax.custom_derivatives.SymbolicZero)


def _made(tangents: Any) -> Any:
    def fill(x):
        if _zero(x):
            return jnp.zeros(x.shape, x.dtype)
        return x

    return jax.tree.map(fill, tangents, is_leaf=_zero)


_acceleration.defjvp(_acceleration_jvp, symbolic_zeros=True)


@jax.custom_jvp
def _inverse_mass(tree, inertial, q, armature):
    return _inverted(_with_armature(mass_matrix(tree, inertial, q), armature))


def _inverse_mass_jvp(primals, tangents):
    tree, inertial, q, armature = primals
    d_tree, d_inertial, d_q, d_armature = tangents
    every, rows = _wholly(tree, inertial)
    still = _still(every, rows, _angles(tree, q))
    whole = _up(every, still.body)
    inverse = _inverted(_with_armature(_on_both(tree, _mass(every, still, whole, q[0])), armature))
    by_q = None
    if not _zero(d_q):  # [i, j, k]: by the angle k
        cube = jnp.moveaxis(_mass_by_q(every, still, whole, q[0]), 2, 0)
        by_q = jnp.moveaxis(jax.vmap(lambda z: _on_both(tree, z))(_on_one(tree, cube)), 0, 2)
    inverse, by_q = _computed((inverse, by_q), q)
    change = jnp.zeros_like(inverse)
    if by_q is not None:
        change = change + sum(by_q[:, :, k] * d_q[k][None, None] for k in range(tree.n))
    if not _zero(d_armature):
        change = _with_armature(change, d_armature)
    if not _zero(d_inertial):
        every, d_rows = _wholly(tree, d_inertial, True)
        moved_by = _still(every, d_rows, _angles(tree, q))
        change = change + _on_both(tree, _mass(every, moved_by, _up(every, moved_by.body), q[0]))
    if not all(map(_zero, jax.tree.leaves(d_tree, is_leaf=_zero))):
        change = (
            change
            + jax.jvp(lambda tree: mass_matrix(tree, inertial, q), (tree,), (_made(d_tree),))[1]
        )

    def product(a: Array, b: Array) -> Array:
        return sum(a[:, k][:, None] * b[k][None] for k in range(tree.n))

    return inverse, -product(inverse, product(change, inverse))


_inverse_mass.defjvp(_inverse_mass_jvp, symbolic_zeros=True)


def _mass_by_q(tree: Tree, still: Still, whole: InertialBody, like: jax.Array) -> jax.Array:
    """`[n, n, n, ...]`: derivative of the mass matrix's entry i, j by the angle k. Only what lies
    between two joints, or is carried by both, changes it: with j carrying i, either k is between
    (then joint j's screw turns against the rest), or i carries k.
    """
    n, carries, eye = tree.n, _ancestry(tree), np.eye(tree.n, dtype=bool)

    def at(pair: Pair, own: str) -> Pair:
        """Entries with the axes `own`, in that order, on the axes i, j, k."""
        missing = [axis for axis in "ijk" if axis not in own]
        order = [(own + "".join(missing)).index(axis) for axis in "ijk"]

        def spread(x):
            front, behind = x.shape[: len(own)], x.shape[len(own) :]
            return x.reshape(*front, *(1,) * len(missing), *behind)

        def place(x):
            if known(x):
                return x
            return jnp.transpose(spread(x), (*order, *range(3, spread(x).ndim)))

        return jax.tree.map(place, pair)

    def first(x):
        return jax.tree.map(lambda y: y if known(y) else y[:, None], x)

    def second(x):
        return jax.tree.map(lambda y: y if known(y) else y[None], x)

    turns = cross_motion(
        first(still.screw), second(still.screw)
    )  # [j, k]: screw j turned by joint k, less its sign
    pull = momentum(
        first(whole), second(still.screw)
    )  # [k, i]: what joint k carries, moved by joint i
    between = dot_pair(at(momentum(whole, still.screw), "i"), at(turns, "jk"))
    carried = add(
        dot_pair(at(turns, "jk"), at(pull, "ki")), dot_pair(at(pull, "kj"), at(turns, "ik"))
    )
    below, strictly = carries.T, carries.T & ~eye  # [i, j]: joint j carries joint i
    in_between = (
        below[:, :, None] & strictly.T[None] & below[:, None, :]
    )  # j above k, and k carries i
    further = below[:, :, None] & strictly.T[:, None, :]  # i above k

    def cube(x, mask):
        whole = jnp.broadcast_to(jnp.asarray(x, like.dtype), (n, n, n, *like.shape))
        return whole * _mask(mask, like)

    lower = cube(between, in_between) + cube(carried, further)
    return lower + jnp.swapaxes(lower, 0, 1) * _mask(~eye, like)[:, :, None]
