"""The contact solve of one step: SAP's convex problem by Newton's method (Castro, Permenter and Han
2022).

Velocities after the step minimise `|v - v*|_M^2 / 2 + sum of l_i(v)`, where `v*` is the velocity
without contact and `l_i` the regularised cost of contact i: half of `R_n gamma_n^2 + R_t gamma_t^2`
of an impulse that is known in closed form. The problem is convex, so Newton's method with an exact
line search ends at its one minimum.

Here there are three unknowns: x and z velocity m/s and spin rad/s. A point with normal velocity v_n
and tangential v_t, with `R_n = 1 / (dt k (dt + tau))`, pressed in by p / g, has `y_n = (p / g / (dt
+ tau) - v_n) / R_n`, `y_r = |v_t| / R_t`, and sticks if `y_r <= mu y_n`, is open if `y_n <= -m y_r`
with `m = mu R_t / R_n`, and slides in between.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from adaptsim_jax.tasks.scooping.hydro_contact import Contacts
from adaptsim_jax.tasks.scooping.hydro_shapes import PieceBody

Array = Any
ROUNDS = 2  # of the line search, after its bounds are known
SOLVED = {4: 2e-5, 8: 1e-10}
"""By the size of a float in bytes: the unbalanced share of the momentum at which Newton's method
stops.
"""
PATIENCE, SLOW = 9, 1e-4
"""Newton's steps before points that slide by less than so many m/s count as sticking in the
Hessian.
"""


class Springs(NamedTuple):
    """What stays fixed during a solve, each field `[N]`: rows of the normal and the tangential
    Jacobian (x, z, spin), the surface's velocities and the speed m/s that the spring asks for,
    inverses of R_n and R_t kg, friction, m and 1 / (1 + mu m) of the law, and 1 where the point is
    active.
    """

    normal: tuple[Array, Array, Array]
    tangent: tuple[Array, Array, Array]
    lift: Array
    slide: Array
    press: Array
    stiff: Array
    grip: Array
    friction: Array
    lever: Array
    share: Array
    active: Array


class Solve(NamedTuple):
    """velocity `[3]`. residual `[]`: Norm of the momentum that is unbalanced by that of what there
    is to balance. impulse `[3]`: Of all contacts together (N s, N s, N m s).
    """

    velocity: Array
    residual: Array
    impulse: Array


def springs(
    c: Contacts, piece: PieceBody, dt: float, tau: float, slip: float, near_rigid: float
) -> Springs:
    """Contacts as regularised springs with damping time `tau` s.

    `slip`: sigma, R_t as a share of a point's effective inverse mass. `near_rigid`: beta, above 0
    softens springs that are too stiff for the step.
    """
    nx, nz = -c.tz, c.tx

    def arm(x, z):
        return x * c.rz - z * c.rx

    light = 1.0 / piece.mass + (c.rx**2 + c.rz**2) / (2.0 * piece.inertia)
    stiffness = jnp.where(c.active > 0, c.area * c.growth, 1.0)
    softest = near_rigid**2 / (4 * jnp.pi**2) * light
    r_normal = jnp.maximum(softest, 1.0 / (dt * stiffness * (dt + tau)))
    stiff, grip = 1.0 / r_normal, 1.0 / (slip * light)
    lever = c.friction * stiff / grip
    return Springs(
        (nx, nz, arm(nx, nz)),
        (c.tx, c.tz, arm(c.tx, c.tz)),
        c.lift,
        c.slide,
        c.pressure / (c.growth * (dt + tau)),
        stiff,
        grip,
        c.friction,
        lever,
        1.0 / (1.0 + c.friction * lever),
        c.active,
    )


def solve(
    s: Springs,
    firsts: tuple[int, ...],
    piece: PieceBody,
    free: Array,
    guess: Array,
    iterations: int,
) -> Solve:
    """The velocity `[3]` after a step, from `free [3]`, the velocity without contact, starting at
    `guess [3]`; `firsts`: the place of one point of each flat surface.

    Derivatives are those of the minimum, by the implicit function theorem: Newton's iterations run
    on constants, and one more step from their end carries the dependence on everything else.
    """
    mass = jnp.stack([piece.mass, piece.mass, piece.inertia])
    fixed = jax.lax.stop_gradient((s, mass, free, guess))
    found = _newton(fixed[0], firsts, *fixed[1:], iterations)
    gradient, impulse, bend = _slope(s, mass, free, found)
    velocity = found - _solve3(jax.lax.stop_gradient(bend), gradient)
    return Solve(velocity, _unbalanced(mass, free, gradient, impulse), impulse)


def _unbalanced(mass: Array, free: Array, gradient: Array, impulse: Array) -> Array:
    def size(v):
        return jnp.sqrt(jnp.sum(v * v / mass))

    return size(gradient) / (size(mass * free) + size(impulse) + 1e-9)


def _newton(
    s: Springs, firsts: tuple[int, ...], mass: Array, free: Array, guess: Array, iterations: int
) -> Array:
    """Iterates until the momentum balances; under vmap, until it does for all samples.

    Where the minimum lies on the kink between sliding one way and the other, steps from either side
    end just across it, and may go to and fro with hardly any gain. After `PATIENCE` steps what
    hardly slides is therefore held, as far as curvature goes: steps then run along the kink. Any
    positive Hessian descends, so the minimum is the same.
    """
    enough = SOLVED[guess.dtype.itemsize]

    def one(carry):
        v, count, _ = carry
        gradient, impulse, bend = _slope(
            s, mass, free, v, jnp.where((count < PATIENCE) | (count % 2 == 0), 0.0, SLOW)
        )
        left = _unbalanced(mass, free, gradient, impulse)
        move = -_solve3(bend, gradient)
        return v + _best_share(s, firsts, mass, free, v, move) * move, count + 1, left > enough

    def go_on(carry):
        return carry[2] & (carry[1] < iterations)

    return jax.lax.while_loop(go_on, one, (guess, jnp.zeros((), jnp.int32), jnp.ones((), bool)))[0]


def _best_share(
    s: Springs, firsts: tuple[int, ...], mass: Array, free: Array, v: Array, move: Array
) -> Array:
    """The share of `move`, at most 1, at which the cost is least.

    Along a line the cost's slope rises; the share is its root. It nearly jumps where a surface
    passes from sliding one way to sliding the other, and sticks in between, over some micrometres a
    second. Those places are known: tangential speed is the same all over a flat surface. They bound
    the root, and Newton's method in one dimension does the rest.
    """
    here, along = _relative(s, v), _speeds(s, move)
    inertia, pull = jnp.sum(mass * move * move), jnp.sum(mass * (v - free) * move)

    def slopes(share):
        law = _law(s, here[0] + share * along[0], here[1] + share * along[1])
        nn, nt, tt = _stiffness(s, law)
        first = pull + share * inertia - _sum(law.normal * along[0] - law.tangent * along[1])
        bend = nn * along[0] ** 2 + 2.0 * nt * along[0] * along[1] + tt * along[1] ** 2
        return first, inertia + _sum(bend)

    at = jnp.array(firsts)
    turning = -here[1][at] / jnp.where(along[1][at] == 0.0, 1.0, along[1][at])
    shares = jnp.concatenate(
        [jnp.where((turning > 0) & (turning < 1), turning, 1.0), jnp.ones(1, v.dtype)]
    )
    first, second = jax.vmap(slopes)(shares)
    low = jnp.max(jnp.where(first < 0, shares, 0.0))
    high = jnp.min(jnp.where(first < 0, 1.0, shares))
    guess = shares - first / second
    distant = jnp.where((guess > low) & (guess < high), jnp.abs(guess - shares), jnp.inf)
    start = jnp.where(
        jnp.isfinite(jnp.min(distant)), guess[jnp.argmin(distant)], 0.5 * (low + high)
    )

    def one(_, bounds):
        low, high, share = bounds
        first, second = slopes(share)
        low, high = jnp.where(first < 0, share, low), jnp.where(first < 0, high, share)
        guess = share - first / second
        return low, high, jnp.where((guess > low) & (guess < high), guess, 0.5 * (low + high))

    share = jax.lax.fori_loop(0, ROUNDS, one, (low, high, start))[2]
    return jnp.where(first[-1] <= 0.0, 1.0, share)


def _sum(x: Array) -> Array:
    """The sum of `x [N]`, eight at a time where they go up evenly: strict order would keep the
    processor from it.
    """
    if x.shape[0] % 8 == 0:
        return jnp.sum(jnp.sum(x.reshape(-1, 8), 0))
    return jnp.sum(x)


def _speeds(s: Springs, v: Array) -> tuple[Array, Array]:
    """Normal and tangential velocity `[N]` of the piece's points."""
    a, b = s.normal, s.tangent
    normal = a[0] * v[0] + a[1] * v[1] + a[2] * v[2]
    tangential = b[0] * v[0] + b[1] * v[1] + b[2] * v[2]
    return normal, tangential


def _relative(s: Springs, v: Array) -> tuple[Array, Array]:
    vn, vt = _speeds(s, v)
    return vn - s.lift, vt - s.slide


class _Law(NamedTuple):
    normal: Array  # impulse along the normal
    tangent: Array  # impulse against the sliding, signed as the sliding
    way: Array  # friction coefficient, signed as the sliding
    sticks: Array
    slides: Array


def _law(s: Springs, vn: Array, vt: Array) -> _Law:
    """Impulses at velocities relative to the surfaces, projected on the friction cone in the norm
    of R.
    """
    yn, yt = (s.press - vn) * s.stiff, vt * s.grip
    yr = jnp.abs(yt)
    sticks = (yr <= s.friction * yn) & (s.active > 0)
    slides = (yn > -s.lever * yr) & (s.active > 0) & ~sticks
    way = jnp.where(vt < 0, -s.friction, s.friction)
    sliding = (yn + s.lever * yr) * s.share
    normal = jnp.where(sticks, yn, jnp.where(slides, sliding, 0.0))
    return _Law(normal, jnp.where(sticks, yt, way * normal), way, sticks, slides)


def _stiffness(s: Springs, law: _Law) -> tuple[Array, Array, Array]:
    """Second derivatives of the contacts' costs: normal, mixed, tangential."""
    slope = jnp.where(law.slides, s.stiff * s.share, 0.0)
    mixed = -slope * law.way
    return (
        jnp.where(law.sticks, s.stiff, slope),
        mixed,
        jnp.where(law.sticks, s.grip, -mixed * law.way),
    )


def _slope(
    s: Springs, mass: Array, free: Array, v: Array, held: Array | float = 0.0
) -> tuple[Array, Array, list[list[Array]]]:
    """Gradient `[3]` of the cost, impulse `[3]` of the contacts, and the Hessian's lower triangle;
    in that, points that slide by less than `held` m/s stick.
    """
    vn, vt = _relative(s, v)
    law = _law(s, vn, vt)
    a, b = s.normal, s.tangent
    impulse = jnp.stack([_sum(law.normal * a[i] - law.tangent * b[i]) for i in range(3)])
    slow = law.slides & (jnp.abs(vt) < held)
    nn, nt, tt = _stiffness(s, law._replace(sticks=law.sticks | slow, slides=law.slides & ~slow))

    def entry(i, j):
        by_normal = nn * a[i] * a[j] + nt * (a[i] * b[j] + b[i] * a[j])
        return _sum(by_normal + tt * b[i] * b[j])

    bend = [[entry(i, j) + (mass[i] if i == j else 0.0) for j in range(i + 1)] for i in range(3)]
    return mass * (v - free) - impulse, impulse, bend


def _solve3(bend: list[list[Array]], right: Array) -> Array:
    """The symmetric positive definite system of three unknowns, scaled to a unit diagonal, by
    Cholesky's factors.
    """
    scale = [1.0 / jnp.sqrt(bend[i][i]) for i in range(3)]
    h = [[bend[i][j] * scale[i] * scale[j] for j in range(i + 1)] for i in range(3)]
    l10, l20 = h[1][0], h[2][0]
    l11 = jnp.sqrt(jnp.maximum(1.0 - l10 * l10, 1e-12))
    l21 = (h[2][1] - l20 * l10) / l11
    l22 = jnp.sqrt(jnp.maximum(1.0 - l20 * l20 - l21 * l21, 1e-12))
    y0 = right[0] * scale[0]
    y1 = (right[1] * scale[1] - l10 * y0) / l11
    y2 = (right[2] * scale[2] - l20 * y0 - l21 * y1) / l22
    x2 = y2 / l22
    x1 = (y1 - l21 * x2) / l11
    x0 = y0 - l10 * x1 - l20 * x2
    return jnp.stack([x0 * scale[0], x1 * scale[1], x2 * scale[2]])
