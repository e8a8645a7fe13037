"""Double pendulum as two rigid links in a plane, with a torque at each joint.

q1 is the angle of link 1 from `angle_zero` (hanging or upright), q2 that of link 2 relative to link 1, both
in rad and counter-clockwise. All dynamics go through six *base parameters* `theta: [6]`, the most that motion
and torque can fix (Gautier & Khalil, "Direct calculation of minimum set of inertial parameters", IEEE T-RA
6(3), 1990):

    M11 = p1 + 2 l1 h2 cos q2    M12 = p2 + l1 h2 cos q2    M22 = p3    p2 = p3 + coupling
    p1 = I1 + m1 c1^2 + I2 + m2 (l1^2 + c2^2) + n1^2 J1 + J2        p3 = I2 + m2 c2^2 + n2^2 J2      (kg m^2)
    h1 = m1 c1 + m2 l1                                              h2 = m2 c2                       (kg m)

with l1 and gravity known. Rotor convention: the motor of joint 1 is fixed to the ground and that of joint 2
to link 1; a rotor (J, about its parallel axis; its mass counts in the body that carries the motor) turns
`gear` times as fast as its joint, relative to that body, in the same sense for a positive gear. So `coupling
= J2 n2 (1 - n2)`: zero without a rotor, and zero for a direct drive. Arrays are `[2]`; a trailing batch axis
works too.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from adaptsim_jax.core.constants import GRAVITY
from adaptsim_jax.core.errors import BadInput

Array = Any

BASE_NAMES = ("p1", "p3", "h1", "h2", "b1", "b2")
BASE_UNITS = ("kg m^2", "kg m^2", "kg m", "kg m", "N m s/rad", "N m s/rad")


@partial(jax.tree_util.register_dataclass, data_fields=["l1", "gravity", "coupling"], meta_fields=["angle_zero"])
@dataclass(frozen=True)
class Geometry:
    """What base-parameter dynamics must know besides theta: `l1` m, `gravity` m/s^2, `coupling` kg m^2."""

    l1: Any
    gravity: Any = GRAVITY
    coupling: Any = 0.0
    angle_zero: str = "hanging"

    @property
    def down(self) -> float:
        """+1 where zero angle hangs, -1 where it stands upright."""
        return 1.0 if self.angle_zero == "hanging" else -1.0


_INERTIAL = ["mass", "length", "com", "inertia", "damping", "rotor_inertia", "gear", "gravity"]


@partial(jax.tree_util.register_dataclass, data_fields=_INERTIAL, meta_fields=["angle_zero"])
@dataclass(frozen=True)
class RigidPendulum:
    """Inertial parameters of both links, each `[2]`; build one from user input with `rigid_pendulum`, which
    checks.

    `mass` kg, `length` m, `com` m from the joint along the link, `inertia` kg m^2 about the centre of mass,
    `damping` N m s/rad, `rotor_inertia` kg m^2 and `gear` as in the module's text, `gravity` m/s^2.
    """

    mass: Array
    length: Array
    com: Array
    inertia: Array
    damping: Array
    rotor_inertia: Array = field(default_factory=lambda: np.zeros(2))
    gear: Array = field(default_factory=lambda: np.ones(2))
    gravity: Any = GRAVITY
    angle_zero: str = "hanging"


class Simulated(NamedTuple):
    """`q, v: [T + 1, 2]` rad, rad/s; `code: []` int32: 0, or 1 where the motion ceased to be finite."""

    q: Array
    v: Array
    code: Array


def rigid_pendulum(
    mass: Sequence[float],
    length: Sequence[float],
    com: Sequence[float],
    inertia: Sequence[float],
    damping: Sequence[float] = (0.0, 0.0),
    rotor_inertia: Sequence[float] = (0.0, 0.0),
    gear: Sequence[float] = (1.0, 1.0),
    gravity: float = GRAVITY,
    angle_zero: str = "hanging",
) -> RigidPendulum:
    """A checked `RigidPendulum`; raises `BadInput` naming the parameter that is not physical."""
    if angle_zero not in ("hanging", "upright"):
        raise BadInput(f"angle_zero: {angle_zero!r} is not known; use 'hanging' or 'upright'")
    least = {"mass": 0.0, "length": 0.0, "com": -np.inf, "inertia": 0.0, "damping": 0.0, "rotor_inertia": 0.0}
    given = dict(zip(_INERTIAL, (mass, length, com, inertia, damping, rotor_inertia, gear), strict=False))
    for name, values in given.items():
        array = np.asarray(values, float)
        if array.shape != (2,) or not np.all(np.isfinite(array)):
            raise BadInput(f"{name}: needs one finite number for each of the two links, got {values!r}")
        strict = name in ("mass", "length")
        if name in least and np.any(array <= 0 if strict else array < least[name]):
            raise BadInput(f"{name}: {values!r} is not physical; it must {'exceed' if strict else 'be at least'} 0")
    if not np.isfinite(gravity):
        raise BadInput(f"gravity: {gravity!r} is not a number; give it in m/s^2, such as 9.81")
    arrays = {name: jnp.asarray(values, float) for name, values in given.items()}
    return RigidPendulum(**arrays, gravity=gravity, angle_zero=angle_zero)


# --- base parameters ---


def base_parameters(p: RigidPendulum) -> Array:
    """`theta: [6] = p1, p3, h1, h2, b1, b2` of inertial parameters; many of these share one theta."""
    (m1, m2), (l1, _), (c1, c2), (I1, I2) = p.mass, p.length, p.com, p.inertia
    (J1, J2), (n1, n2), (b1, b2) = p.rotor_inertia, p.gear, p.damping
    p1 = I1 + m1 * c1**2 + I2 + m2 * (l1**2 + c2**2) + n1**2 * J1 + J2
    p3 = I2 + m2 * c2**2 + n2**2 * J2
    return jnp.stack([jnp.asarray(x) for x in (p1, p3, m1 * c1 + m2 * l1, m2 * c2, b1, b2)])


def base_geometry(p: RigidPendulum) -> Geometry:
    """The known part that goes with `base_parameters(p)`."""
    n2 = p.gear[1]
    return Geometry(p.length[0], p.gravity, p.rotor_inertia[1] * n2 * (1 - n2), p.angle_zero)


def base_is_physical(theta: Array, geometry: Geometry) -> Array:
    """Whether damping is not negative and the mass matrix positive definite at every q2, `[]` bool."""
    p1, p3, _, h2, b1, b2 = theta
    c = geometry.l1 * h2
    # The determinant is concave in cos q2, so its least value is at one of the ends.
    ends = [(p1 + 2 * s * c) * p3 - (p3 + geometry.coupling + s * c) ** 2 for s in (1.0, -1.0)]
    return (p3 > 0) & (ends[0] > 0) & (ends[1] > 0) & (b1 >= 0) & (b2 >= 0)


def base_mass_matrix(theta: Array, geometry: Geometry, q: Array) -> tuple[Array, Array, Array]:
    """`M11, M12, M22` kg m^2, each `[]`."""
    p1, p3, _, h2, _, _ = theta
    c = geometry.l1 * h2 * jnp.cos(q[1])
    return p1 + 2 * c, p3 + geometry.coupling + c, p3 + 0 * c


def base_passive(theta: Array, geometry: Geometry, q: Array, v: Array) -> Array:
    """Torque `[2]` N m that holds `v` constant: Coriolis, gravity and viscous friction."""
    coriolis, gravity = base_coriolis(theta, geometry, q, v), base_gravity(theta, geometry, q)
    return coriolis + gravity + jnp.stack([theta[4] * v[0], theta[5] * v[1]])


def base_coriolis(theta: Array, geometry: Geometry, q: Array, v: Array) -> Array:
    """Coriolis and centrifugal torque `C(q, v) v: [2]` N m."""
    s = geometry.l1 * theta[3] * jnp.sin(q[1])
    return jnp.stack([-s * v[1] * (2 * v[0] + v[1]), s * v[0] ** 2])


def base_gravity(theta: Array, geometry: Geometry, q: Array) -> Array:
    """Gradient `[2]` N m of the potential energy."""
    g = geometry.gravity * geometry.down
    outer = g * theta[3] * jnp.sin(q[0] + q[1])
    return jnp.stack([g * theta[2] * jnp.sin(q[0]) + outer, outer])


def base_forward_dynamics(theta: Array, geometry: Geometry, q: Array, v: Array, tau: Array) -> Array:
    """Acceleration `[2]` rad/s^2 from `theta: [6]`, `q, v: [2]` and the joint torques `tau: [2]` N m."""
    m11, m12, m22 = base_mass_matrix(theta, geometry, q)
    f1, f2 = tau - base_passive(theta, geometry, q, v)
    determinant = m11 * m22 - m12 * m12
    return jnp.stack([(m22 * f1 - m12 * f2) / determinant, (m11 * f2 - m12 * f1) / determinant])


def base_inverse_dynamics(theta: Array, geometry: Geometry, q: Array, v: Array, a: Array) -> Array:
    """Joint torques `[2]` N m that give acceleration `a: [2]` rad/s^2; linear in theta."""
    m11, m12, m22 = base_mass_matrix(theta, geometry, q)
    return jnp.stack([m11 * a[0] + m12 * a[1], m12 * a[0] + m22 * a[1]]) + base_passive(theta, geometry, q, v)


# --- the same by inertial parameters ---


def mass_matrix(p: RigidPendulum, q: Array) -> Array:
    """Mass matrix `[2, 2]` kg m^2 at `q: [2]`."""
    m11, m12, m22 = base_mass_matrix(base_parameters(p), base_geometry(p), q)
    return jnp.stack([jnp.stack([m11, m12]), jnp.stack([m12, m22])])


def coriolis(p: RigidPendulum, q: Array, v: Array) -> Array:
    """Coriolis and centrifugal torque `[2]` N m."""
    return base_coriolis(base_parameters(p), base_geometry(p), q, v)


def gravity(p: RigidPendulum, q: Array) -> Array:
    """Torque `[2]` N m that holds the links still at `q: [2]`."""
    return base_gravity(base_parameters(p), base_geometry(p), q)


def forward_dynamics(p: RigidPendulum, q: Array, v: Array, tau: Array) -> Array:
    """Acceleration `[2]` rad/s^2 under joint torques `tau: [2]` N m."""
    return base_forward_dynamics(base_parameters(p), base_geometry(p), q, v, tau)


def inverse_dynamics(p: RigidPendulum, q: Array, v: Array, a: Array) -> Array:
    """Joint torques `[2]` N m for acceleration `a: [2]` rad/s^2."""
    return base_inverse_dynamics(base_parameters(p), base_geometry(p), q, v, a)


def energy(p: RigidPendulum, q: Array, v: Array) -> Array:
    """Kinetic plus potential energy `[]` J, rotors included; the potential is zero with both joints level."""
    theta, geometry = base_parameters(p), base_geometry(p)
    m11, m12, m22 = base_mass_matrix(theta, geometry, q)
    kinetic = 0.5 * (m11 * v[0] ** 2 + m22 * v[1] ** 2) + m12 * v[0] * v[1]
    height = theta[2] * jnp.cos(q[0]) + theta[3] * jnp.cos(q[0] + q[1])
    return kinetic - geometry.down * geometry.gravity * height


def linearize(p: RigidPendulum) -> tuple[Array, Array]:
    """`A: [4, 4], B: [4, 2]` of the deviation from upright at rest, state `(q1, q2, v1, v2)`, by autodiff."""
    upright = jnp.zeros(2) if p.angle_zero == "upright" else jnp.array([jnp.pi, 0.0])

    def deriv(x: Array, tau: Array) -> Array:
        return jnp.concatenate([x[2:], forward_dynamics(p, x[:2], x[2:], tau)])

    return jax.jacfwd(deriv, (0, 1))(jnp.concatenate([upright, jnp.zeros(2)]), jnp.zeros(2))


# --- motion ---


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


def step(p: RigidPendulum, q: Array, v: Array, tau: Array, dt: Any, substeps: int = 1) -> tuple[Array, Array]:
    """State `q, v: [2]` after `dt` s with `tau: [2]` N m held."""
    return base_step(base_parameters(p), base_geometry(p), q, v, tau, dt, substeps)


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
