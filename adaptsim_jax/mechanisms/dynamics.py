"""Dynamics of a `Tree`: mass matrix, bias force, regressor, acceleration, positions and energy.

Arrays are `[n, ...batch]` with the batch last, and everything is written out as sums and products of such lanes over the few
joints, so that it vectorises over the batch. Vectors are in the world's axes and moments about each joint's own origin: nothing
is turned from frame to frame, and a distal link's inertia is not lost beside what its mass makes about the base in single
precision. Inverse dynamics are Luh, Walker and Paul's recursion ("On-line computational scheme for mechanical manipulators",
1980), the mass matrix is built from composite bodies (Walker and Orin, 1982), and its factor keeps the zeros of branches
(Featherstone, "Efficient factorization of the joint-space inertia matrix for branched kinematic trees", 2005).

`inertial [n, 10]`, `gravity [3]` and `armature [n]` are arguments of their own and may carry the batch's axes. Where a
`tree.massless` body is concerned, its row of `inertial` is not looked at.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from adaptsim_jax.core.trig import sin_cos
from adaptsim_jax.mechanisms.lanes import (
    IDENTITY,
    ZERO,
    Entry,
    Rows,
    Vector,
    add,
    apply,
    apply_transposed,
    cross,
    dot,
    mul,
    neg,
    plus,
    product,
    stacked,
    sub,
    symmetric,
    times,
    total,
)
from adaptsim_jax.mechanisms.tree import Tree, ancestors

Array = Any


class Pose(NamedTuple):
    """Of a joint's frame: its rotation in the world, and the way to its origin from the origin before it, in the world's axes."""

    rotation: Rows
    way: Vector

    @property
    def axis(self) -> Vector:
        return tuple(row[2] for row in self.rotation)


class Body(NamedTuple):
    """Mass, first moment and moments of inertia about the joint's origin, in the world's axes."""

    mass: Entry
    moment: Vector
    inertia: Rows


NOTHING = Body(0, ZERO, (ZERO, ZERO, ZERO))


def mass_matrix(tree: Tree, inertial: Array, q: Array) -> jax.Array:
    """`[n, n, ...]` kg m^2 (kg m, kg where slides are concerned) at `q: [n, ...]`, without armature."""
    q = jnp.asarray(q)
    poses = _poses(tree, q)
    entries = _mass(tree, poses, _bodies(tree, poses, inertial, q.dtype))
    like = _like(tree, inertial, q)
    n = tree.n
    return jnp.stack([stacked([entries.get((max(i, j), min(i, j)), 0) for j in range(n)], like) for i in range(n)])


def bias_force(tree: Tree, inertial: Array, q: Array, v: Array, gravity: Array) -> jax.Array:
    """`[n, ...]`: Coriolis, centrifugal and gravity forces, with the sign of MuJoCo's `qfrc_bias`: M a + bias = force."""
    return inverse_dynamics(tree, inertial, q, v, None, gravity)


def gravity_force(tree: Tree, inertial: Array, q: Array, gravity: Array) -> jax.Array:
    """`[n, ...]`: what gravity does to each joint, minus the bias force at rest."""
    return -inverse_dynamics(tree, inertial, q, None, None, gravity)


def inverse_dynamics(
    tree: Tree, inertial: Array, q: Array, v: Array | None, a: Array | None, gravity: Array
) -> jax.Array:
    """`[n, ...]`: generalized forces that make `q, v, a: [n, ...]` come about, without armature; `v` or `a` None stands for 0."""
    q = jnp.asarray(q)
    poses = _poses(tree, q)
    bodies = _bodies(tree, poses, inertial, q.dtype)
    forces = _inverse(tree, poses, bodies, _rows(v, tree.n), _rows(a, tree.n), _vector(gravity, q.dtype))
    return stacked(forces, _like(tree, inertial, q, v, a, gravity))


def acceleration(
    tree: Tree, inertial: Array, q: Array, v: Array, force: Array, armature: Array, gravity: Array
) -> jax.Array:
    """`[n, ...]`: of the joints at `q, v: [n, ...]` under the generalized `force: [n, ...]` (all but gravity and inertia)."""
    q = jnp.asarray(q)
    poses = _poses(tree, q)
    bodies = _bodies(tree, poses, inertial, q.dtype)
    bias = _inverse(tree, poses, bodies, _rows(v, tree.n), _rows(None, tree.n), _vector(gravity, q.dtype))
    mass = _mass(tree, poses, bodies)
    armature = jnp.asarray(armature, q.dtype)
    for i in range(tree.n):
        mass[i, i] = add(mass[i, i], armature[i])
    before = [ancestors(tree, i) for i in range(tree.n)]
    out = _solved(mass, [force[i] - bias[i] for i in range(tree.n)], before)
    return stacked(out, _like(tree, inertial, q, v, force, armature, gravity))


def regressor(tree: Tree, q: Array, v: Array, a: Array, gravity: Array) -> jax.Array:
    """`[n, 10 n, ...]`: inverse dynamics are `regressor @ inertial.ravel()` (Atkeson, An and Hollerbach, 1986)."""
    q = jnp.asarray(q)
    poses = _poses(tree, q)
    motion = _motion(tree, poses, _rows(v, tree.n), _rows(a, tree.n), _vector(gravity, q.dtype))
    like = _like(tree, None, q, v, a, gravity)
    rows: list[list[Entry]] = [[0] * (10 * tree.n) for _ in range(tree.n)]
    for j in range(tree.n):
        if tree.shapes[j].massless:
            continue
        wrench = _body_regressor(poses[j].rotation, *motion[j])
        way: Vector = ZERO
        for i in (j, *ancestors(tree, j)):
            axis = poses[i].axis
            turn, push = (axis, cross(axis, way)) if tree.kinds[i] == "hinge" else (ZERO, axis)
            turn, push = (apply_transposed(poses[j].rotation, x) for x in (turn, push))
            rows[i][10 * j : 10 * j + 10] = [add(dot(push, force), dot(turn, moment)) for force, moment in wrench]
            way = plus(way, poses[i].way)
    return jnp.stack([stacked(row, like) for row in rows])


def solve(mass: Array, rhs: Array, parent: Sequence[int] | None = None) -> jax.Array:
    """`[n, ...]`: `mass [n, n, ...]`, symmetric and positive definite, into `rhs [n, ...]`. With a tree's `parent` the zeros
    between its branches cost nothing; the matrix must have them."""
    n = rhs.shape[0]
    mass, rhs = jnp.asarray(mass), jnp.asarray(rhs)
    before = [tuple(range(i - 1, -1, -1)) if parent is None else _before(parent, i) for i in range(n)]
    entries = {(i, j): mass[i, j] for i in range(n) for j in (i, *before[i])}
    return stacked(
        _solved(entries, list(rhs), before), jnp.zeros(jnp.broadcast_shapes(mass.shape[2:], rhs.shape[1:]), rhs.dtype)
    )


def passive_force(tree: Tree, q: Array, v: Array) -> jax.Array:
    """`[n, ...]`: of the declared springs and dampers, MuJoCo's `qfrc_passive`. Dry friction is not among them."""
    q, v = jnp.asarray(q), jnp.asarray(v)
    out = []
    for i in range(tree.n):
        damping, stiffness, rest, higher, harder = (
            jnp.asarray(x[i], q.dtype)
            for x in (tree.damping, tree.stiffness, tree.springref, tree.damping_poly, tree.stiffness_poly)
        )
        x = q[i] - rest
        fast, far = jnp.abs(v[i]), jnp.abs(x)
        out.append(
            -(damping + higher[0] * fast + higher[1] * fast**2) * v[i]
            - (stiffness + harder[0] * far + harder[1] * far**2) * x
        )
    return stacked(out, _like(tree, None, q, v))


def body_position(tree: Tree, q: Array, body: int, point: Array = (0.0, 0.0, 0.0)) -> jax.Array:
    """`[3, ...]` m, in the world: a point given in the frame of joint `body`, which sits on the body that it moves."""
    q = jnp.asarray(q)
    poses = _poses(tree, q)
    chain = (body, *ancestors(tree, body))
    out = apply(poses[body].rotation, _vector(point, q.dtype))
    for i in chain:
        out = plus(out, poses[i].way)
    return stacked(out, _like(tree, None, q))


def tip_height(tree: Tree, q: Array, body: int, point: Array = (0.0, 0.0, 0.0)) -> jax.Array:
    """`[...]` m: of a point as in `body_position`, against gravity and from the world's origin."""
    at = body_position(tree, q, body, point)
    up = -jnp.asarray(tree.gravity, at.dtype)
    up = up / jnp.sqrt(jnp.sum(up**2))
    return at[0] * up[0] + at[1] * up[1] + at[2] * up[2]


def energy(tree: Tree, inertial: Array, q: Array, v: Array, armature: Array, gravity: Array) -> jax.Array:
    """`[...]` J: kinetic (with armature) and potential (zero where all centres of mass are at the world's origin)."""
    q, v = jnp.asarray(q), jnp.asarray(v)
    poses = _poses(tree, q)
    bodies = _bodies(tree, poses, inertial, q.dtype)
    mass = _mass(tree, poses, bodies)
    armature, down = jnp.asarray(armature, q.dtype), _vector(gravity, q.dtype)
    parts = [mul(0.5 * v[i] * v[i], add(mass[i, i], armature[i])) for i in range(tree.n)]
    parts += [mul(v[i] * v[j], m) for (i, j), m in mass.items() if i != j]
    origin: list[Vector] = []
    for i, p in enumerate(tree.parent):
        origin.append(poses[i].way if p < 0 else plus(origin[p], poses[i].way))
        parts.append(neg(dot(down, plus(bodies[i].moment, times(bodies[i].mass, origin[i])))))
    return stacked([total(parts)], _like(tree, inertial, q, v, armature, gravity))[0]


def _vector(x: Any, dtype: Any) -> Vector:
    return tuple(jnp.asarray(x, dtype))


def _rows(x: Any, n: int) -> list[Entry]:
    return [0] * n if x is None else [x[i] for i in range(n)]


def _like(tree: Tree, inertial: Any, q: jax.Array, *others: Any) -> jax.Array:
    """Zeros of the batch's shape: what all arguments have behind their own axes."""
    shapes = [jnp.shape(x)[1:] for x in (q, *others, tree.place[:, 0], tree.gravity) if x is not None]
    shapes += [] if inertial is None else [jnp.shape(inertial)[2:]]
    return jnp.zeros(jnp.broadcast_shapes(*shapes), q.dtype)


def _poses(tree: Tree, q: jax.Array) -> list[Pose]:
    sines, cosines = sin_cos(q) if "hinge" in tree.kinds else (q, q)
    place, rotation = jnp.asarray(tree.place, q.dtype), jnp.asarray(tree.rotation, q.dtype)
    poses: list[Pose] = []
    for i, (kind, p) in enumerate(zip(tree.kinds, tree.parent, strict=True)):
        before = IDENTITY if p < 0 else poses[p].rotation
        shape = tree.shapes[i]
        still = tuple(
            tuple(rotation[i, r, c] if x is None else x for c, x in enumerate(row))
            for r, row in enumerate(shape.rotation)
        )
        way = apply(before, [place[i, k] if x is None else x for k, x in enumerate(shape.place)])
        turned = product(before, still)
        if kind == "slide":
            poses.append(Pose(turned, plus(way, times(q[i], [row[2] for row in turned]))))
        else:
            s, c = sines[i], cosines[i]
            rows = [(add(mul(c, x), mul(s, y)), sub(mul(c, y), mul(s, x)), z) for x, y, z in turned]
            poses.append(Pose(tuple(rows), way))
    return poses


def _bodies(tree: Tree, poses: list[Pose], inertial: Any, dtype: Any) -> list[Body]:
    inertial = jnp.asarray(inertial, dtype)
    bodies = []
    for i, pose in enumerate(poses):
        if tree.shapes[i].massless:
            bodies.append(NOTHING)
            continue
        mass, x, y, z, *six = inertial[i]
        half = product(pose.rotation, symmetric(*six))
        entry = lambda r, c, half=half, pose=pose: dot(half[r], pose.rotation[c])
        inertia = symmetric(entry(0, 0), entry(0, 1), entry(0, 2), entry(1, 1), entry(1, 2), entry(2, 2))
        bodies.append(Body(mass, apply(pose.rotation, (x, y, z)), inertia))
    return bodies


def _motion(
    tree: Tree, poses: list[Pose], v: list[Entry], a: list[Entry], gravity: Vector
) -> list[tuple[Vector, Vector, Vector]]:
    """For each body its angular velocity, its angular acceleration, and the acceleration of its origin less gravity."""
    out: list[tuple[Vector, Vector, Vector]] = []
    for i, pose in enumerate(poses):
        p = tree.parent[i]
        omega, alpha, linear = out[p] if p >= 0 else (ZERO, ZERO, tuple(neg(g) for g in gravity))
        linear = plus(linear, plus(cross(alpha, pose.way), cross(omega, cross(omega, pose.way)))) if p >= 0 else linear
        along = times(v[i], pose.axis)
        sideways = cross(omega, along)
        push = times(a[i], pose.axis)
        if tree.kinds[i] == "hinge":
            omega, alpha = plus(omega, along), plus(alpha, plus(sideways, push))
        else:
            linear = plus(linear, plus(plus(sideways, sideways), push))
        out.append((omega, alpha, linear))
    return out


def _inverse(
    tree: Tree, poses: list[Pose], bodies: list[Body], v: list[Entry], a: list[Entry], gravity: Vector
) -> list[Entry]:
    motion = _motion(tree, poses, v, a, gravity)
    wrenches = [_wrench(body, *m) for body, m in zip(bodies, motion, strict=True)]
    out: list[Entry] = [0] * tree.n
    for i in reversed(range(tree.n)):
        force, moment = wrenches[i]
        out[i] = dot(poses[i].axis, moment if tree.kinds[i] == "hinge" else force)
        if (p := tree.parent[i]) >= 0:
            there = plus(moment, cross(poses[i].way, force))
            wrenches[p] = plus(wrenches[p][0], force), plus(wrenches[p][1], there)
    return out


def _wrench(body: Body, omega: Vector, alpha: Vector, linear: Vector) -> tuple[Vector, Vector]:
    """Force, and moment about the origin, that move a body so."""
    swing = plus(cross(alpha, body.moment), cross(omega, cross(omega, body.moment)))
    turn = plus(apply(body.inertia, alpha), cross(omega, apply(body.inertia, omega)))
    return plus(times(body.mass, linear), swing), plus(turn, cross(body.moment, linear))


def _body_regressor(rotation: Rows, omega: Vector, alpha: Vector, linear: Vector) -> list[tuple[Vector, Vector]]:
    """Force and moment, in the body's own axes, for one unit of each inertial parameter."""
    w, dw, a = (apply_transposed(rotation, x) for x in (omega, alpha, linear))
    out: list[tuple[Vector, Vector]] = [(a, ZERO)]
    for unit in IDENTITY:
        out.append((plus(cross(dw, unit), cross(w, cross(w, unit))), cross(unit, a)))
    for r, c in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
        spun, sped = list(ZERO), list(ZERO)
        for i, j in {(r, c), (c, r)}:
            spun[i], sped[i] = w[j], dw[j]
        out.append((ZERO, plus(sped, cross(w, spun))))
    return out


def _mass(tree: Tree, poses: list[Pose], bodies: list[Body]) -> dict[tuple[int, int], Entry]:
    """Entries `(i, j)` for i and j = i or an ancestor of i; all others are zero, or the same mirrored."""
    whole = list(bodies)
    out: dict[tuple[int, int], Entry] = {}
    for i in reversed(range(tree.n)):
        axis, body = poses[i].axis, whole[i]
        if tree.kinds[i] == "hinge":
            force, moment = cross(axis, body.moment), apply(body.inertia, axis)
        else:
            force, moment = times(body.mass, axis), cross(body.moment, axis)
        at = i
        for j in (i, *ancestors(tree, i)):
            if j != i:
                moment = plus(moment, cross(poses[at].way, force))
                at = j
            out[i, j] = dot(poses[j].axis, moment if tree.kinds[j] == "hinge" else force)
        if (p := tree.parent[i]) >= 0:
            whole[p] = _together(whole[p], _moved(body, poses[i].way))
    return out


def _moved(body: Body, d: Vector) -> Body:
    """The same body about a point from which its origin is `d` away."""
    h, inertia = body.moment, body.inertia
    much = add(dot(h, d), dot(plus(h, times(body.mass, d)), d))  # 2 h.d + m d.d
    md = plus(h, times(body.mass, d))  # so that h d' + d h' + m d d' = h d' + d md'
    entry = lambda r, c: sub(inertia[r][c], add(mul(h[r], d[c]), mul(d[r], md[c])))
    six = [add(entry(r, c), much) if r == c else entry(r, c) for r in range(3) for c in range(r, 3)]
    return Body(body.mass, md, symmetric(*six))


def _together(a: Body, b: Body) -> Body:
    return Body(
        add(a.mass, b.mass),
        plus(a.moment, b.moment),
        tuple(plus(x, y) for x, y in zip(a.inertia, b.inertia, strict=True)),
    )


def _before(parent: Sequence[int], i: int) -> tuple[int, ...]:
    out = []
    while (i := parent[i]) >= 0:
        out.append(i)
    return tuple(out)


def _solved(mass: dict[tuple[int, int], Entry], rhs: list[Entry], before: list[tuple[int, ...]]) -> list[Entry]:
    """By M = L' D L with L unit lower triangular, which has no entries that M has not (Featherstone, 2005)."""
    m, x = dict(mass), list(rhs)
    n = len(x)
    inverse: list[Entry] = [0] * n
    for k in reversed(range(n)):
        inverse[k] = 1.0 / m[k, k]
        for i in before[k]:
            factor = mul(m[k, i], inverse[k])
            for j in (i, *before[i]):
                m[i, j] = sub(m[i, j], mul(factor, m[k, j]))
            x[i] = sub(x[i], mul(factor, x[k]))
            m[k, i] = factor
    for k in range(n):
        x[k] = mul(x[k], inverse[k])
        for i in before[k]:
            x[k] = sub(x[k], mul(m[k, i], x[i]))
    return x
