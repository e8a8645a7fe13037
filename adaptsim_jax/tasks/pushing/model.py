"""The bottle push (paper, section V-B and appendix): what every backend of it shares.

A plate at the end of an arm runs along a straight line at yaw `angle`, hits a standing bottle low,
and stops. The bottle slides on over a table with a square patch of other friction. Positions in m
in the arm's base frame, table top at z = 0.

Sample parameters `params: [4]` are `PARAMETERS`; an action `[2]` is (speed m/s, angle rad).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from adaptsim_jax.core.constants import GRAVITY
from adaptsim_jax.core.errors import BadInput

Array = Any

PARAMETERS = ("mu", "e", "mu_p", "y_p")
"""Friction of the table, hydroelastic modulus of the bottle Pa, friction of the patch, lateral
place of the patch m.
"""
LOW = (0.05, 1e4, 0.2, -0.1)
HIGH = (0.20, 1e6, 0.8, 0.1)
"""Omega of the paper (its table of the pushing task); e is spread logarithmically."""
PHYSICAL_LOW = (0.005, 1e3, 0.005, -1.0)
PHYSICAL_HIGH = (2.0, 1e7, 2.0, 1.0)
"""What the scenes can be built with: the map of e is held at these ends."""
ACTION_LOW = (0.4, -0.3)
ACTION_HIGH = (0.8, 0.3)

LEVEL = (0.0, 0.0, -GRAVITY)
"""Gravity m/s2 over a level table."""
START = (0.56, 0.0)
"""Where the bottle stands before a push, m."""
RADIUS, HEIGHT = 0.03, 0.10
SOLE_RATE, SOLE_DAMPING = 80.0, 1.0
SOLE_SAG = GRAVITY / (2 * SOLE_RATE**2)
SOLE_DELAY = 2 * SOLE_DAMPING / SOLE_RATE
"""The ground's spring under the bottle (see engines/scene.xml): rad/s and ratio, depth at rest m,
damping by stiffness s.
"""
PATCH_X, PATCH_SIDE, PATCH_EDGE = 0.75, 0.10, 0.002
"""Centre of the patch along x, its side, and the width over which a foot passes from one friction
to the other, m.
"""
NOMINAL_MASS = 0.3
FALLEN_TILT = math.radians(30.0)

# The release's commands to link 8: still, ramp up, hold, ramp down; the plate's edge hangs
# `EDGE_DROP` below the link.
STILL, RAMP_UP, HOLD, RAMP_DOWN = 0.01, 0.2, 0.1, 0.5
PUSH_ENDS = STILL + RAMP_UP + HOLD + RAMP_DOWN
LINK_BACK, LINK_HEIGHT = 0.15, 0.135
EDGE_DROP, EDGE_RADIUS = 0.1175, 0.0025
RISE_SPEED, PITCH_RATE = 0.1, 0.8

FINE, DIVERGED, FALLEN, UNFIT = 0, 1, 2, 3
MESSAGES = {
    FINE: "fine",
    DIVERGED: "the motion ceased to be finite, or the bottle left the room or sank through the "
    "table",
    FALLEN: "the bottle tilted by more than 30 degrees",
    UNFIT: "parameters, action or start are not finite, or outside of what a scene can be built "
    "with",
}


@dataclass(frozen=True)
class PushOptions:
    """What is not adapted: semantics of friction, length of a trial, and the bottle's mass
    properties.

    `friction`: `clean` reads the paper's text (the table has mu, the patch mu_p, the plate 0.3);
    `coupled` does what the release does in Drake, where the bottle is given mu_p and pairs combine
    as 2ab/(a+b). So mu_p acts everywhere. `inertia` kg m^2 about `com` m (from the bottle's
    centre) default to the release's bottle, whose inertia is a thousand times a cylinder's and
    whose centre of mass lies below the table: it slides, and hardly turns or tips.
    """

    friction: str = "clean"
    duration: float = 1.3  # s; the release reads the position after 0.81 s
    mass: float = NOMINAL_MASS  # kg
    com: tuple[float, ...] = (0.0, 0.0, -0.10)
    inertia: tuple[float, ...] = (0.3175, 0.3175, 0.135)
    row: float = 0.01  # s between the rows of a trajectory


PAPER = PushOptions()
HEAVY = PushOptions(mass=0.6, inertia=(0.1, 0.1, 0.004), com=(0.0, 0.004, -0.04))
LIGHT = PushOptions(mass=0.15, inertia=(0.05, 0.05, 0.002), com=(0.0, 0.0, -0.03))
"""Stand-ins for the paper's printed bottles, which no parameter models: they go further or less
far, and turn as they go.
"""


def cylinder_inertia(mass: float) -> tuple[float, float, float]:
    """The inertia kg m^2 of a solid cylinder of the bottle's size: the bottle that can turn and
    tip.
    """
    across = mass * (3 * RADIUS**2 + HEIGHT**2) / 12
    return across, across, mass * RADIUS**2 / 2


def check_options(options: PushOptions) -> PushOptions:
    """`options` if a scene can be made of them; BadInput names the key, the reason and the mend
    otherwise.
    """
    o = options
    if o.friction not in ("clean", "coupled"):
        raise BadInput(
            f"pushing, friction = {o.friction!r}: unknown semantics; use clean or coupled"
        )
    _within("duration", o.duration, 0.1, 10.0, "s")
    _within("row", o.row, 0.005, 0.1, "s")
    if abs(o.row / 0.005 - round(o.row / 0.005)) > 1e-6:
        raise BadInput(f"pushing, row = {o.row} s is no multiple of 0.005 s; use 0.01")
    if abs(o.duration / o.row - round(o.duration / o.row)) > 1e-6:
        raise BadInput(
            f"pushing, duration = {o.duration} s is no whole number of rows of {o.row} s; round it"
        )
    _within("mass", o.mass, 0.02, 5.0, "kg")
    for name, values, high in (("com", o.com, 0.2), ("inertia", o.inertia, 10.0)):
        if len(values) != 3 or not all(math.isfinite(v) and abs(v) <= high for v in values):
            raise BadInput(
                f"pushing, {name} = {values}: needs three finite numbers of at most {high}; check "
                "its unit"
            )
    a, b, c = o.inertia
    if min(a, b, c) <= 0 or 2 * max(a, b, c) > (a + b + c) * (1 + 1e-9):
        raise BadInput(
            f"pushing, inertia = {o.inertia}: no body has it (needs a + b >= c > 0); use "
            "cylinder_inertia"
        )
    return options


def _within(name: str, value: float, low: float, high: float, unit: str) -> None:
    if not (isinstance(value, int | float) and low <= value <= high):
        raise BadInput(f"pushing, {name} = {value} is not within {low} to {high} {unit}; change it")


def rows(options: PushOptions) -> int:
    """The number of rows of a trajectory; row k is at `(k + 1) * options.row` s."""
    return round(options.duration / options.row)


# ---------------------------------------------------------------- what parameters mean


class Frictions(NamedTuple):
    """Coulomb coefficients of the three pairs, each of the shape of its parameter."""

    table: Array
    patch: Array
    plate: Array


def frictions(params: Array, semantics: str) -> Frictions:
    """Pair coefficients of `params [..., 4]` (NumPy or JAX).

    `coupled`: over the patch the release's table and patch overlap flush and carry half of the load
    each.
    """
    mu, mu_p = params[..., 0], params[..., 2]
    if semantics == "clean":
        return Frictions(mu, mu_p, 0.0 * mu + 0.3)
    table = 2 * mu * mu_p / (mu + mu_p)
    return Frictions(table, 0.5 * (table + mu_p), 0.6 * mu_p / (0.3 + mu_p))


class ElasticityMap(NamedTuple):
    """Contact of plate and bottle as a damped spring, whose constants follow the modulus and the
    speed of the hit.

    With u = log10(e / 1e5 Pa) and h = ln of the hit's speed by 0.7 m/s, ln w and ln zeta are
    quadratics in u, of coefficients `frequency: [3]` and `damping: [3]` (lowest order first), plus
    `speed: [2]` times h. For a bottle of `NOMINAL_MASS`, stiffness per mass is k = w^2 1/s^2 and
    damping per mass b = 2 zeta w 1/s. Speed is there because Drake damps as Hunt and Crossley do,
    harder the faster the hit, and its pressure field stiffens as it is pressed.
    """

    frequency: tuple[Any, ...]
    damping: tuple[Any, ...]
    speed: tuple[Any, ...] = (0.0, 0.0)


ELASTICITY = ElasticityMap((3.621, 0.252, 0.204), (-1.498, 0.340, 0.040), (-0.260, 0.977))
"""The map of the MuJoCo scenes, fitted to Drake by `experiments/pushing_elasticity.py`."""


def spring(
    elasticity: ElasticityMap, e: Array, speed: Array, mass: float, xp: Any = np
) -> tuple[Array, Array]:
    """`(k 1/s^2, b 1/s)` per bottle mass at modulus `e` Pa and a push of `speed` m/s.

    A heavier bottle meets the same spring with more mass.
    """
    u = xp.log10(xp.clip(e, PHYSICAL_LOW[1], PHYSICAL_HIGH[1])) - 5.0
    h = xp.log((speed + PITCH_RATE * EDGE_DROP) / 0.7)

    def quadratic(c, more):
        return c[0] + c[1] * u + c[2] * u * u + more * h

    # Bounds keep the explicit step of 5 ms stable wherever a fit may wander.
    w = xp.exp(
        xp.clip(
            quadratic(elasticity.frequency, elasticity.speed[0]), math.log(10.0), math.log(200.0)
        )
    )
    zeta = xp.exp(
        xp.clip(quadratic(elasticity.damping, elasticity.speed[1]), math.log(0.005), math.log(3.0))
    )
    share = NOMINAL_MASS / mass
    return w * w * share, xp.clip(2 * zeta * w, 0.0, 250.0) * share


# ---------------------------------------------------------------- the ground


def on_patch(x: Array, y: Array, y_p: Array, xp: Any = np) -> Array:
    """How far a point is on the patch, in [0, 1]; 1 inside, 0 outside, linear over the edge's 2
    mm.
    """

    def inside(d):
        return xp.clip((PATCH_SIDE / 2 - xp.abs(d)) / PATCH_EDGE + 0.5, 0.0, 1.0)

    return inside(x - PATCH_X) * inside(y - y_p)


def sole() -> np.ndarray:
    """`[12, 2]` m: points of equal area of the bottle's sole, seen from its axis, where the
    ground's friction acts.
    """
    turn = np.pi / 3 * np.arange(6)

    def ring(share, at):
        return RADIUS * np.sqrt(share) * np.stack([np.cos(at), np.sin(at)], -1)

    return np.concatenate([ring(0.25, turn + np.pi / 6), ring(0.75, turn)])


def ground_friction(
    pose: Array, friction: Frictions, y_p: Array, mass: float, dt: float, xp: Any = np
) -> Array:
    """Friction of table and patch on a bottle, `[..., 6]`: force in the world N, torque in the
    bottle's frame N m.

    `pose: [..., 13]` as the backends' states; `friction` and `y_p`: `[..., 1]`. Coulomb's law at
    each point of the sole, under a pressure that grows with its depth. So what stands on the patch
    bears its share of the weight and no more. (MuJoCo's own friction, convex as it is, loads the
    grippier contacts with most of the weight.)
    """
    px, py = sole().T.astype(np.float32)
    x, y, z, qw, qx, qy, qz, vx, vy, vz, wx, wy, wz = (pose[..., k : k + 1] for k in range(13))
    turn = (
        (1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qw * qz), 2 * (qx * qz + qw * qy)),
        (2 * (qx * qy + qw * qz), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qw * qx)),
        (2 * (qx * qz - qw * qy), 2 * (qy * qz + qw * qx), 1 - 2 * (qx * qx + qy * qy)),
    )
    pz = -HEIGHT / 2
    spin = (wy * pz - wz * py, wz * px - wx * pz, wx * py - wy * px)
    rx, ry, rz = (t[0] * px + t[1] * py + t[2] * pz for t in turn)
    ux, uy, uz = (
        v + t[0] * spin[0] + t[1] * spin[1] + t[2] * spin[2]
        for t, v in zip(turn, (vx, vy, vz), strict=True)
    )
    pressed = xp.maximum(0.0, (-(z + rz) - SOLE_DELAY * uz) / SOLE_SAG)
    mu = friction.table + on_patch(x + rx, y + ry, y_p, xp) * (friction.patch - friction.table)
    # below `slow` friction is viscous, which an explicit step can bear
    slow = 2 * dt * GRAVITY * mu + 1e-4
    weight = mass * GRAVITY / len(px)
    brake = -mu * pressed * weight
    grip = brake / xp.maximum(xp.sqrt(ux * ux + uy * uy + 1e-12), slow)
    fx, fy = grip * ux, grip * uy

    def total(f):
        return f.sum(-1, keepdims=True)

    torque = (total(-rz * fy), total(rz * fx), total(rx * fy - ry * fx))
    local = [sum(turn[k][i] * torque[k] for k in range(3)) for i in range(3)]
    return xp.concatenate([total(fx), total(fy), 0 * total(fx), *local], -1)


# ---------------------------------------------------------------- the pusher


def ramp(t: Array) -> np.ndarray:
    """The profile in [0, 1] that forward speed, rise and pitch rate of link 8 share, at times `t`
    s.
    """
    t = np.asarray(t, float) - STILL
    down = np.clip(1 - (t - RAMP_UP - HOLD) / RAMP_DOWN, 0, 1)
    after_rise = np.where(t < RAMP_UP + HOLD, 1.0, down)
    moving = np.where(t < RAMP_UP, t / RAMP_UP, after_rise)
    return np.where(t < 0, 0.0, moving)


def slopes(dt: float, steps: int) -> np.ndarray:
    """`[steps]` 1/s: the constant slope of `ramp` for each step, so that a step ends on the
    profile.
    """
    return np.diff(ramp(np.arange(steps + 1) * dt)) / dt


def draw(seed: int, samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random `params [B, 4]` over Omega, actions `[B, 2]`, and starts `[B, 2]` at `START`."""
    rng = np.random.default_rng(seed)
    low, high = np.array(LOW), np.array(HIGH)
    low[1], high[1] = np.log10(low[1]), np.log10(high[1])
    params = rng.uniform(low, high, (samples, 4))
    params[:, 1] = 10 ** params[:, 1]
    actions = rng.uniform(ACTION_LOW, ACTION_HIGH, (samples, 2))
    return params, actions, np.tile(START, (samples, 1))
