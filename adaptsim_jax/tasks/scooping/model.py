"""Scooping a piece of food with a spatula (paper, section V-C and appendix): what every engine of
it shares.

A thin blade, pitched nose down, slides along the table under a piece that stands there, and is
pitched up. The piece is an ellipsoid, a cylinder or a box with a soft surface. Nothing depends on
where the piece stands, so lengths along the table are counted from where it stood. Everything is
symmetric about the vertical plane of the motion.

Sample parameters `params: [4]` are `PARAMETERS`; an action `[3]` is (initial pitch rad, pitch rate
rad/s, distance m). `state [B, T, 6]` has rows of `ROW` s: the piece's x, y, z m and the tip's x, z
m and pitch rad.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from adaptsim_jax.core.constants import GRAVITY as GRAVITY
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.engine import Trajectory, checked_batch

Array = Any

PARAMETERS = ("mu", "e", "g", "h")
"""Friction of piece with table and blade, hydroelastic modulus Pa, shape (see `SHAPES`), height m.
"""
SHAPES = ("ellipsoid", "cylinder", "box")  # as MuJoCo calls them
ELLIPSOID, CYLINDER, BOX = range(3)
LOW = (0.25, 1e4, 0.0, 0.015)
HIGH = (0.40, 5e5, 1.0, 0.025)
"""Omega of the paper (its table of the scooping task); e is spread logarithmically, g is a
category.
"""
PHYSICAL_LOW = (0.02, 1e3, 0.0, 0.006)
PHYSICAL_HIGH = (1.5, 1e7, 2.0, 0.04)
"""What the engines are made for."""
ACTION_LOW = (math.radians(2.0), -0.2, 0.005)
ACTION_HIGH = (math.radians(10.0), 0.2, 0.02)

RADIUS, DENSITY = 0.015, 1000.0
"""Half the width of every piece m, its density kg/m^3."""
NECK_FRICTION = 0.15
SECONDS = 1.0
OBSERVED_AT = (0.0, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0)
"""Length of a trial, and when the piece is seen, s."""

# The spatula, in the frame of its tip: x ahead, z up; see `motion`. Boxes by centre and half-size,
# m.
BLADE_CENTRE, BLADE_HALF = (-0.0501, 0.0002), (0.05, 0.0006)
BLADE_HALF_WIDTH = 0.04
NECK_CENTRE, NECK_HALF, NECK_RISE = (-0.1083, 0.0048), (0.01, 0.001), 0.46
NECK_HALF_WIDTH = 0.03
TIP_AHEAD, TIP_BELOW = 0.177, 0.143
"""Where the tip lies, seen from the link whose velocity is commanded: ahead in the spatula's frame;
below, of which `GRIP_BELOW` in the world's frame at the start and the rest in the spatula's.
"""
GRIP_BELOW = 0.10
RISEN = 3.25e-3
"""Height of a piece's centre over the tip's plane, m, from which it counts as lying on the blade:
2.5 mm over its surface.
"""

FINE, DIVERGED, UNSOLVED, UNFIT = 0, 1, 2, 3
MESSAGES = {
    FINE: "fine",
    DIVERGED: "the motion ceased to be finite, or the piece left the room",
    UNSOLVED: "the contact solve of some step did not converge",
    UNFIT: "parameters or action are not finite, or outside of what the engines are made for",
}


@dataclass(frozen=True)
class ScoopOptions:
    """What is not adapted.

    clearance: Height of the blade's lower edge over the table while it slides, m. The arm presses
        it down, a real blade bends. noise: half-widths of the uniform error with which pitch (rad),
        rate (rad/s) and distance (m) are executed.
    press: Speed at which the arm sinks while sliding, m/s; 0 in the paper, 0.01 in the release.
    """

    clearance: float = 5e-5
    noise: tuple[float, ...] = (0.012, 0.04, 0.0)
    press: float = 0.0


def check_options(options: ScoopOptions) -> ScoopOptions:
    """`options` if they make sense; BadInput names the key, the reason and the mend otherwise."""
    o = options
    if not 0.0 <= o.clearance <= 0.01:
        raise BadInput(
            f"scooping, clearance = {o.clearance} m is not within 0 to 0.01; give it in metres"
        )
    if len(o.noise) != 3 or not all(math.isfinite(n) and n >= 0 for n in o.noise):
        raise BadInput(
            f"scooping, noise = {o.noise}: needs three numbers of at least 0 (rad, rad/s, m)"
        )
    if not 0.0 <= o.press <= 0.1:
        raise BadInput(
            f"scooping, press = {o.press} m/s is not within 0 to 0.1; the release has 0.01"
        )
    return options


def physical_action(action: Array) -> Array:
    """`[..., 3]` in [-1, 1] to (pitch rad, rate rad/s, distance m); NumPy or JAX."""
    low, high = np.array(ACTION_LOW, np.float32), np.array(ACTION_HIGH, np.float32)
    lead = (1,) * (action.ndim - 1)
    return ((low + high) / 2).reshape(*lead, 3) + action * ((high - low) / 2).reshape(*lead, 3)


def on_blade(ahead: Array, above: Array) -> Array:
    """Whether a centre at `(ahead, above)` m in the tip's frame lies on the spatula: 1 or 0."""
    back = -(BLADE_HALF[0] * 2 + NECK_HALF[0] * 2 + RADIUS)
    return ((above > RISEN) & (ahead > back) & (ahead < RADIUS)) * 1.0


def draw(seed: int, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Random `params [B, 4]` over Omega and actions `[B, 3]`."""
    rng = np.random.default_rng(seed)
    low, high = np.array(LOW), np.array(HIGH)
    low[1], high[1] = np.log(low[1]), np.log(high[1])
    params = rng.uniform(low, high, (samples, 4))
    params[:, 1] = np.exp(params[:, 1])
    params[:, 2] = np.round(params[:, 2])
    return params, rng.uniform(ACTION_LOW, ACTION_HIGH, (samples, 3))


@dataclass(frozen=True)
class Numerics:
    """What makes up *the* simulator besides physics; static under jit. See
    docs/explanation/scooping.md for how much each matters.

    dt: s. relaxation: Tau of the damping, s, of the pair. slip: Sigma of SAP's friction.
        near_rigid: Beta of SAP, 0 for none.
    iterations: Of Newton's method in a step, at most. grid: Columns along and points across each of
        table, blade, its front, neck.
    tolerance: Unbalanced share of the momentum above which a step counts as unsolved.
    """

    dt: float = 2.5e-3
    relaxation: float = 0.2
    slip: float = 1e-2
    near_rigid: float = 0.0
    iterations: int = 15
    grid: tuple[tuple[int, int], ...] = ((6, 2), (8, 2), (2, 2), (4, 2))
    tolerance: float = 1e-3


def check_numerics(numerics: Numerics) -> Numerics:
    """`numerics` if a trial can be cut into such steps; BadInput otherwise."""
    n = numerics
    if not 1e-4 <= n.dt <= 0.01 or abs(SECONDS / n.dt - round(SECONDS / n.dt)) > 1e-6:
        raise BadInput(
            f"scooping, dt = {n.dt} s: give a whole part of 1 s from 1e-4 to 0.01, such as 0.0025"
        )
    if n.relaxation < 0 or n.slip <= 0 or n.near_rigid < 0 or n.tolerance <= 0:
        raise BadInput(
            f"scooping, {n}: relaxation and near_rigid must be at least 0, slip and tolerance "
            "positive"
        )
    if n.iterations < 1 or len(n.grid) != 4 or min(min(pair) for pair in n.grid) < 1:
        raise BadInput(
            f"scooping, {n}: at least one iteration, and four pairs of positive counts as grid"
        )
    return numerics


ROW = 0.01  # s between rows; row k is at (k + 1) ROW
STATE = 6
BATCH = 64  # trials side by side on a CPU: more do not fit into its cache


def checked_trials(params: Any, commands: Any, initial: Any) -> list[np.ndarray]:
    """The batch as arrays `[B, 4]`, `[B, 3]`, `[B, 2]`; BadInput where shapes do not fit
    together.
    """
    given = {"params": params, "commands": commands, "initial": initial}
    return checked_batch("scooping", given, (4, 3, 2))


def placed(state: np.ndarray, codes: np.ndarray, starts: np.ndarray) -> Trajectory:
    """The trajectory with lengths along the table counted as the caller does."""
    state[..., 0] += starts[:, None, 0]
    state[..., 1] += starts[:, None, 1]
    state[..., 3] += starts[:, None, 0]
    return Trajectory(state, codes)


def outcome(state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`(success [B], above [B] m)` at the end of `state [B, T, 6]`; `above`: height over the tip's
    plane.
    """
    x, _, z, tip_x, tip_z, pitch = np.moveaxis(state[:, -1], -1, 0)
    c, s = np.cos(pitch), np.sin(pitch)
    dx, dz = x - tip_x, z - tip_z
    ahead, above = c * dx - s * dz, s * dx + c * dz
    return np.asarray(on_blade(ahead, above)), above
