"""Double pendulum as two rigid links in a plane, with a torque at each joint.

q1 is the angle of link 1 from `angle_zero` (hanging or upright), q2 that of link 2 relative to link 1, both
in rad and counter-clockwise. All dynamics go through six *base parameters* `theta: [6]`, the most that motion
and torque can fix (Gautier & Khalil, "Direct calculation of minimum set of inertial parameters", IEEE T-RA
6(3), 1990), p1, p3, h1, h2 and the joints' dampings b1, b2:

    M11 = p1 + 2 l1 h2 cos q2    M12 = p3 + l1 h2 cos q2    M22 = p3
    p1 = I1 + m1 c1^2 + I2 + m2 (l1^2 + c2^2)    p3 = I2 + m2 c2^2    (kg m^2)
    h1 = m1 c1 + m2 l1                           h2 = m2 c2           (kg m)

with l1 and gravity known. Arrays are `[2]`; a trailing batch axis works too.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from adaptsim_jax.core.constants import GRAVITY

Array = Any


@partial(jax.tree_util.register_dataclass, data_fields=["l1", "gravity"], meta_fields=["angle_zero"])
@dataclass(frozen=True)
class Geometry:
    """What base-parameter dynamics must know besides theta: `l1` m, `gravity` m/s^2."""

    l1: Any
    gravity: Any = GRAVITY
    angle_zero: str = "hanging"

    @property
    def down(self) -> float:
        """+1 where zero angle hangs, -1 where it stands upright."""
        return 1.0 if self.angle_zero == "hanging" else -1.0


_INERTIAL = ["mass", "length", "com", "inertia", "damping", "gravity"]


@partial(jax.tree_util.register_dataclass, data_fields=_INERTIAL, meta_fields=["angle_zero"])
@dataclass(frozen=True)
class RigidPendulum:
    """Inertial parameters of both links, each `[2]`: `mass` kg, `length` m, `com` m from the joint along the link, `inertia` kg m^2
    about the centre of mass, `damping` N m s/rad; `gravity` m/s^2."""

    mass: Array
    length: Array
    com: Array
    inertia: Array
    damping: Array
    gravity: Any = GRAVITY
    angle_zero: str = "hanging"


class Simulated(NamedTuple):
    """`q, v: [T + 1, 2]` rad, rad/s; `code: []` int32: 0, or 1 where the motion ceased to be finite."""

    q: Array
    v: Array
    code: Array


def base_parameters(p: RigidPendulum) -> Array:
    """`theta: [6] = p1, p3, h1, h2, b1, b2` of inertial parameters; many of these share one theta."""
    (m1, m2), (l1, _), (c1, c2), (I1, I2), (b1, b2) = p.mass, p.length, p.com, p.inertia, p.damping
    p1 = I1 + m1 * c1**2 + I2 + m2 * (l1**2 + c2**2)
    p3 = I2 + m2 * c2**2
    return jnp.stack([jnp.asarray(x) for x in (p1, p3, m1 * c1 + m2 * l1, m2 * c2, b1, b2)])


def base_geometry(p: RigidPendulum) -> Geometry:
    """The known part that goes with `base_parameters(p)`."""
    return Geometry(p.length[0], p.gravity, p.angle_zero)


def base_gravity(theta: Array, geometry: Geometry, q: Array) -> Array:
    """Gradient `[2]` N m of the potential energy."""
    g = geometry.gravity * geometry.down
    outer = g * theta[3] * jnp.sin(q[0] + q[1])
    return jnp.stack([g * theta[2] * jnp.sin(q[0]) + outer, outer])


def base_forward_dynamics(theta: Array, geometry: Geometry, q: Array, v: Array, tau: Array) -> Array:
    """Acceleration `[2]` rad/s^2 from `theta: [6]`, `q, v: [2]` and the joint torques `tau: [2]` N m."""
    p1, p3, _, h2, b1, b2 = theta
    c = geometry.l1 * h2 * jnp.cos(q[1])
    m11, m12, m22 = p1 + 2 * c, p3 + c, p3
    s = geometry.l1 * h2 * jnp.sin(q[1])
    coriolis = jnp.stack([-s * v[1] * (2 * v[0] + v[1]), s * v[0] ** 2])
    # the torque that holds v constant
    passive = coriolis + base_gravity(theta, geometry, q) + jnp.stack([b1 * v[0], b2 * v[1]])
    f1, f2 = tau - passive
    determinant = m11 * m22 - m12 * m12
    return jnp.stack([(m22 * f1 - m12 * f2) / determinant, (m11 * f2 - m12 * f1) / determinant])


def base_step(
    theta: Array, geometry: Geometry, q: Array, v: Array, tau: Array, dt: Any, substeps: int = 1
) -> tuple[Array, Array]:
    """State after `dt` s with `tau: [2]` N m held, by `substeps` classical Runge-Kutta steps."""
    h = dt / substeps

    def accelerate(q: Array, v: Array) -> Array:
        return base_forward_dynamics(theta, geometry, q, v, tau)

    def substep(_: Any, qv: tuple[Array, Array]) -> tuple[Array, Array]:
        q, v = qv
        a1 = accelerate(q, v)
        v2 = v + 0.5 * h * a1
        a2 = accelerate(q + 0.5 * h * v, v2)
        v3 = v + 0.5 * h * a2
        a3 = accelerate(q + 0.5 * h * v2, v3)
        v4 = v + h * a3
        a4 = accelerate(q + h * v3, v4)
        return q + h / 6 * (v + 2 * v2 + 2 * v3 + v4), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)

    return lax.fori_loop(0, substeps, substep, (q, v)) if substeps > 1 else substep(0, (q, v))


def simulate(p: RigidPendulum, q0: Array, v0: Array, tau: Array, dt: Array, substeps: int = 1) -> Simulated:
    """Motion from `q0, v0: [2]` under `tau: [T, 2]` N m, each row held for `dt: [T]` or `[]` s."""
    theta, geometry = base_parameters(p), base_geometry(p)

    def advance(qv: tuple[Array, Array], row: tuple[Array, Array]) -> Any:
        qv = base_step(theta, geometry, *qv, *row, substeps)
        return qv, qv

    dtype = jnp.result_type(theta, float)
    start = (jnp.asarray(q0, dtype), jnp.asarray(v0, dtype))
    _, (q, v) = lax.scan(advance, start, (tau, jnp.broadcast_to(dt, tau.shape[:1])))
    q, v = jnp.concatenate([start[0][None], q]), jnp.concatenate([start[1][None], v])
    return Simulated(q, v, jnp.where(jnp.all(jnp.isfinite(q) & jnp.isfinite(v)), 0, 1))
