"""What the closed loop knows of a model: `Plant`, and how to make one of a declared pendulum.

A plant is a mechanical model in generalized coordinates,

    d/dt momentum(theta, q, v) = push(theta, q, v) + u + force,

whose two sides are linear in `theta` (for a rigid body these are the base parameters: Gautier and Khalil, 1990), so
that a start value comes from linear regression and the data can fix what they can fix, no more.
Arrays carry any trailing batch axes: `x: [S, ...]`, `u: [U, ...]`, `force: [n, ...]`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import lsq_linear

from adaptsim_jax.errors import BadInput


class Physical(NamedTuple):
    """A declared physical parameter; `value` is None where the data cannot fix it."""

    value: float | None
    unit: str
    identifiable: bool


@dataclass(frozen=True)
class Plant:
    """A model as pure functions of `(constants, theta, ...)`; a pytree whose leaves are numbers, so that two plants of
    the same kind but other geometry share one compiled program.

    mass(constants, theta, q [n, ...]) -> [n, n, ...]; gravity(constants, theta, q) -> [n, ...];
    push(constants, theta, q, v) -> [n, ...]: all forces but the input; momentum_push(constants, theta, q, v) ->
    [n, ...]: what changes the momentum `mass v` beside the input, for the regression.
    """

    name: str
    joint_dim: int
    command_dim: int
    theta_names: tuple[str, ...]
    theta_units: tuple[str, ...]
    mass: Callable
    push: Callable
    gravity: Callable
    momentum_push: Callable
    declared: Callable
    constants: Mapping[str, np.ndarray]
    low: np.ndarray  # [P]
    high: np.ndarray  # [P]; low == high marks a known parameter
    sound: Callable | None = None  # (constants, theta) -> theta with which the model can be simulated at all

    @property
    def state_dim(self) -> int:
        return 2 * self.joint_dim

    @property
    def joints(self) -> tuple[str, ...]:
        return tuple(f"joint{i + 1}" for i in range(self.joint_dim))

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the measured channels: positions, then velocities."""
        n = self.joint_dim
        return tuple(f"q{i + 1}" for i in range(n)) + tuple(f"v{i + 1}" for i in range(n))

    def deriv(self, theta: jax.Array, x: jax.Array, u: jax.Array, force: jax.Array, inertia: jax.Array) -> jax.Array:
        """Time derivative of `x: [S, ...]` (positions, then velocities) under command `u: [U, ...]` N m, generalized
        force `force: [n, ...]` N m and extra inertia `inertia: [n, ...]` kg m^2 on the diagonal."""
        n = self.joint_dim
        q, v = x[:n], x[n:]
        total = u + force + self.push(self.constants, theta, q, v)
        mass = self.mass(self.constants, theta, q)
        return jnp.concatenate([v, solve_mass(mass, inertia, total)])

    def output(self, x: jax.Array) -> jax.Array:
        """What the sensors would see of `x: [S, ...]`: positions, then velocities."""
        return x

    def gravity_force(self, theta: jax.Array, q: jax.Array) -> jax.Array:
        """Generalized force of gravity `[n, ...]` at `q: [n, ...]`; a tilt of the base adds to the first angle."""
        return self.gravity(self.constants, theta, q)

    def inertia_at(self, theta: jax.Array, q: jax.Array) -> jax.Array:
        """What each joint feels when pushed alone: 1 / diag(M^-1) `[n, ...]` kg m^2."""
        mass = self.mass(self.constants, theta, q)
        n = self.joint_dim
        eye = jnp.eye(n, dtype=mass.dtype).reshape((n, n) + (1,) * (mass.ndim - 2))
        zero = jnp.zeros_like(mass[0])
        columns = [solve_mass(mass, zero, eye[i] + zero)[i] for i in range(n)]
        return 1.0 / jnp.stack(columns)

    def initial_theta(
        self, motions: list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]], interval: float = 0.1
    ):
        """Start value `[P]` by linear regression on momentum balances over `interval` s.

        motions: per trial `(time [T], q [T, n], v [T, n], torque [T, n])`, smoothed. Balances over intervals need no
        acceleration, which noise would drown.
        """
        rows, right = zip(*(_balances(self, *m, interval) for m in motions), strict=True)
        design, target = np.concatenate(rows), np.concatenate(right)
        theta = _bounded_regression(design, target, self.low, self.high)
        return theta if self.sound is None else np.clip(self.sound(self.constants, theta), self.low, self.high)

    def physical(self, theta: np.ndarray, known: Mapping[str, float] | None = None) -> dict[str, Physical]:
        """Declared physical parameters behind `theta: [P]`, each with whether the data (and `known`) fix it."""
        return self.declared(self.constants, np.asarray(theta), dict(known or {}))


jax.tree_util.register_dataclass(
    Plant,
    data_fields=["constants", "low", "high"],
    meta_fields=[
        "name",
        "joint_dim",
        "command_dim",
        "theta_names",
        "theta_units",
        "mass",
        "push",
        "gravity",
        "momentum_push",
        "declared",
        "sound",
    ],
)


def solve_mass(mass: jax.Array, inertia: jax.Array, total: jax.Array) -> jax.Array:
    """`(mass + diag(inertia))^-1 total`, in closed form for one and two joints (batched LAPACK on 2x2 is slow)."""
    n = total.shape[0]
    if n == 1:
        return total / (mass[0] + inertia)
    if n == 2:
        m11, m12, m22 = mass[0, 0] + inertia[0], mass[0, 1], mass[1, 1] + inertia[1]
        det = m11 * m22 - m12 * m12
        return jnp.stack([(m22 * total[0] - m12 * total[1]) / det, (m11 * total[1] - m12 * total[0]) / det])
    full = jnp.moveaxis(mass, (0, 1), (-2, -1)) + jnp.moveaxis(inertia, 0, -1)[..., None] * jnp.eye(n)
    return jnp.moveaxis(jnp.linalg.solve(full, jnp.moveaxis(total, 0, -1)[..., None])[..., 0], -1, 0)


def _balances(plant: Plant, time, q, v, torque, interval: float):
    """Momentum balances over consecutive intervals: `[R * n, P]` and `[R * n]` (impulse, N m s)."""
    with jax.enable_x64(True):
        short = -len(time) % 256  # padded, so that trials of like length share a program
        padded = (np.pad(z.T, ((0, 0), (0, short))) for z in (q, v))
        momentum, push = (np.asarray(z)[:, : len(time)] for z in _momentum_columns(plant, *padded))
    dt = np.diff(time)
    pushed = np.concatenate(
        [np.zeros_like(push[:, :1]), np.cumsum(0.5 * (push[:, 1:] + push[:, :-1]) * dt[None, :, None], 1)], 1
    )
    impulse = np.concatenate([np.zeros((1, torque.shape[1])), np.cumsum(torque[:-1] * dt[:, None], 0)]).T
    stride = max(1, round(interval / float(np.median(dt))))
    cut = np.arange(0, len(time), stride)
    design = np.diff((momentum - pushed)[:, cut], axis=1)
    return design.reshape(-1, design.shape[-1]), np.diff(impulse[:, cut], axis=1).reshape(-1)


@jax.jit
def _momentum_columns(plant: Plant, q, v):
    """Momentum and push per unit of each theta, `[n, T, P]` each: both are linear in theta."""

    def sides(theta):
        momentum = jnp.einsum("ij...,j...->i...", plant.mass(plant.constants, theta, q), v)
        return momentum, plant.momentum_push(plant.constants, theta, q, v)

    return jax.jacfwd(sides)(jnp.zeros(len(plant.theta_names), q.dtype))


def _bounded_regression(design: np.ndarray, target: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    fixed = low == high
    rest = target - design[:, fixed] @ low[fixed]
    scale = np.linalg.norm(design[:, ~fixed], axis=0) + 1e-30
    answer = lsq_linear(design[:, ~fixed] / scale, rest, (low[~fixed] * scale, high[~fixed] * scale))
    theta = low.copy()
    theta[~fixed] = answer.x / scale
    return theta


# --- the pendulum ---------------------------------------------------------------------------------------------------
def _rigid_mass(c, theta, q):
    p1, p3, h2 = theta[0], theta[1], theta[3]
    couple = c["l1"] * h2 * jnp.cos(q[1])
    m12 = p3 + couple
    m11 = p1 + 2.0 * couple
    return jnp.stack([jnp.stack([m11, m12]), jnp.stack([m12, p3 + 0.0 * m11])])


def _rigid_sound(c, theta):
    """`theta` with the inertias raised until the mass matrix is positive definite at every angle: what a regression says of
    slow motions need not be. For any two bodies (p1 - p3) p3 >= (l1 h2)^2."""
    p1, p3 = float(theta[0]), float(theta[1])
    couple = (1.05 * float(c["l1"]) * float(theta[3])) ** 2
    if (p1 - p3) * p3 > couple:
        return theta
    first = max(p1 - p3, 0.1 * p1)
    scale = max(1.0, float(np.sqrt(couple / (first * p3))))
    return np.concatenate([[scale * (first + p3), scale * p3], theta[2:]])


def _rigid_gravity(c, theta, q):
    h1, h2 = theta[2], theta[3]
    second = h2 * jnp.sin(q[0] + q[1])
    return -c["gravity_sign"] * c["g"] * jnp.stack([h1 * jnp.sin(q[0]) + second, second])


def _rigid_push(c, theta, q, v):
    """Coriolis, gravity and viscous forces of the rigid double pendulum (q2 relative to link 1)."""
    bend = c["l1"] * theta[3] * jnp.sin(q[1])
    coriolis = jnp.stack([bend * v[1] * (2.0 * v[0] + v[1]), -bend * v[0] * v[0]])
    return coriolis + _rigid_gravity(c, theta, q) - jnp.stack([theta[4] * v[0], theta[5] * v[1]])


def _rigid_momentum_push(c, theta, q, v):
    """dL/dq and the viscous force: what changes the momentum M v when no torque acts."""
    bend = c["l1"] * theta[3] * jnp.sin(q[1])
    kinetic = jnp.stack([0.0 * bend * v[0], -bend * v[0] * (v[0] + v[1])])
    return kinetic + _rigid_gravity(c, theta, q) - jnp.stack([theta[4] * v[0], theta[5] * v[1]])


def _rigid_declared(c, theta, known):
    """Masses, centres and inertias stand behind p1, p3, h1, h2; only with some of them known can the rest be told."""
    p1, p3, h1, h2, b1, b2 = (float(t) for t in theta)
    l1 = float(c["l1"])
    m1, m2 = known.get("m1"), known.get("m2")
    first = None if m2 is None else h1 - m2 * l1  # m1 lc1
    lc2 = None if m2 is None else h2 / m2
    lc1 = None if m1 is None or first is None else first / m1
    inertia2 = None if m2 is None or lc2 is None else p3 - m2 * lc2**2
    inertia1 = None if m1 is None or m2 is None or lc1 is None else p1 - p3 - m2 * l1**2 - m1 * lc1**2
    values = {"m1": (m1, "kg"), "m2": (m2, "kg"), "lc1": (lc1, "m"), "lc2": (lc2, "m")}
    values |= {"I1": (inertia1, "kg m^2"), "I2": (inertia2, "kg m^2"), "b1": (b1, "N m s/rad"), "b2": (b2, "N m s/rad")}
    return {k: Physical(v, unit, v is not None) for k, (v, unit) in values.items()}


def _linear_mass(c, theta, q):
    m1, m2 = theta[0], theta[1]
    zero = 0.0 * q[0]
    m12 = 2.0 * m2 + zero
    return jnp.stack([jnp.stack([m1 + 4.0 * m2 + zero, m12]), jnp.stack([m12, m2 + zero])])


def _linear_gravity(c, theta, q):
    """Linearized about upright: g [[m1 + 2 m2, m2], [m2, m2]] q (the paper's A times M)."""
    m1, m2 = theta[0], theta[1]
    second = m2 * (q[0] + q[1])
    return c["g"] * jnp.stack([(m1 + m2) * q[0] + second, second])


def _linear_push(c, theta, q, v):
    return _linear_gravity(c, theta, q) - jnp.stack([theta[2] * v[0], theta[3] * v[1]])


def _linear_declared(c, theta, known):
    units = ("kg", "kg", "N m s/rad", "N m s/rad")
    names = ("m1", "m2", "b1", "b2")
    return {k: Physical(float(t), unit, True) for k, t, unit in zip(names, theta, units, strict=True)}


def make_pendulum_plant(
    model: str, angle_zero: str, geometry: Mapping[str, float], known: Mapping[str, float] | None = None
) -> Plant:
    """The declared pendulum: `linearized` (unit lengths, about upright; theta = m1, m2, b1, b2) or `rigid_body`
    (theta = p1 = I1 + m1 lc1^2 + m2 l1^2 + p3, p3 = I2 + m2 lc2^2, h1 = m1 lc1 + m2 l1, h2 = m2 lc2, b1, b2).

    geometry: l1 [m] (needed by `rigid_body`), g [m/s^2]. A `known` name that is in theta is held at its value.
    Raises BadInput on an unknown model or angle zero, or a missing length.
    """
    known = dict(known or {})
    if model == "linearized":
        names, units = ("m1", "m2", "b1", "b2"), ("kg", "kg", "N m s/rad", "N m s/rad")
        low, high = np.array([1e-3, 1e-3, 0.0, 0.0]), np.array([1e3, 1e3, 1e3, 1e3])
        functions = (_linear_mass, _linear_push, _linear_gravity, _linear_push, _linear_declared)
        sound = None  # positive masses are enough
        constants = {"g": np.asarray(float(geometry.get("g", 9.81)))}
    elif model == "rigid_body":
        if angle_zero not in ("upright", "hanging"):
            raise BadInput(f"meta.toml: angle_zero {angle_zero!r} is unknown; use 'upright' or 'hanging'")
        if "l1" not in geometry:
            raise BadInput("meta.toml: [geometry] lacks l1, the length of link 1; add it in metres")
        names = ("p1", "p3", "h1", "h2", "b1", "b2")
        units = ("kg m^2", "kg m^2", "kg m", "kg m", "N m s/rad", "N m s/rad")
        low, high = np.array([1e-6, 1e-6, -1e2, -1e2, 0.0, 0.0]), np.array([1e3, 1e3, 1e3, 1e3, 1e3, 1e3])
        functions = (_rigid_mass, _rigid_push, _rigid_gravity, _rigid_momentum_push, _rigid_declared)
        sound = _rigid_sound
        sign = 1.0 if angle_zero == "hanging" else -1.0
        constants = {"l1": geometry["l1"], "g": geometry.get("g", 9.81), "gravity_sign": sign}
        constants = {k: np.asarray(float(v)) for k, v in constants.items()}
    else:
        raise BadInput(f"meta.toml: model {model!r} is unknown; use 'linearized' or 'rigid_body'")
    for i, name in enumerate(names):
        if name in known:
            low[i] = high[i] = known[name]
    mass, push, gravity, momentum_push, declared = functions
    return Plant(
        f"pendulum/{model}",
        2,
        2,
        names,
        units,
        mass,
        push,
        gravity,
        momentum_push,
        declared,
        constants,
        low,
        high,
        sound,
    )
