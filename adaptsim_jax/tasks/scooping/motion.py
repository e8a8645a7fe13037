"""The spatula's prescribed motion: cubic splines of velocity, integrated exactly (paper, appendix
A4).

Forward speed and pitch rate of the arm's link are cubic splines through values at six knots,
clamped: Their slopes at both ends are zero. A clamped spline is linear in its values, and so is its
integral; with the knots fixed, sampling at given times is one constant matrix. The motion is
therefore a small pure function of the action, differentiable but for one switch: the table keeps
the blade from sinking below it, which the arm's compliance does in reality.

It also says when tracks of pieces contradict their clock or their frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.interpolate import CubicSpline

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.scooping import model
from adaptsim_jax.tasks.scooping.model import ScoopOptions
from adaptsim_jax.tasks.trial_record import TrialKind

Array = Any

KNOTS = (0.0, 0.25, 0.35, 0.60, 0.70, 1.0)
FORWARD = (0.0, 0.6, 0.7, 0.2, 0.0, 0.0)
"""Speed of the link at the knots, m/s."""
PITCH = (0.0, 0.0, -0.6, -0.6, 0.0, 0.0)
"""Pitch rate at the knots, rad/s, the action's added to the second; positive turns the nose down.
"""
PRESS = (0.0, -1.0, -1.0, 1.0, 0.0, 0.0)
"""Vertical speed at the knots, in units of `ScoopOptions.press`."""


@cache
def _travelled(steps: int) -> np.ndarray:
    """`[steps + 1, 6]`: values at the knots to the integrals of their clamped spline, at even times
    over the trial.
    """
    splines = CubicSpline(KNOTS, np.eye(len(KNOTS)), bc_type="clamped")
    return splines.antiderivative()(np.linspace(0.0, KNOTS[-1], steps + 1))


def motion(
    action: Array,
    steps: int,
    options: ScoopOptions = ScoopOptions(),  # noqa: B008
    speed: Array = 1.0,
    lift: Array = 1.0,
) -> Array:
    """The tip's poses `[steps + 1, 3]` (x m from the piece's centre, z m, pitch rad) at even times
    for `action [3]`. Pure, and as precise as `action`. speed, lift: Times the declared speed
    forward and pitch rate.

    The link moves with the splines' velocity; the tip hangs ahead of and below it, and turns with
    it. Then the blade is lifted wherever its lower edges would pass below the clearance.
    """
    pitch, rate, distance = action[0], action[1], action[2]
    table = jnp.asarray(_travelled(steps), action.dtype)
    ahead = speed * (table @ jnp.asarray(FORWARD, action.dtype))
    turned = lift * (table @ jnp.asarray(PITCH, action.dtype) + table[:, 1] * rate)
    sunk = table @ jnp.asarray(PRESS, action.dtype) * options.press
    held = model.TIP_BELOW - model.GRIP_BELOW
    arm_x, arm_z = turn(pitch, model.TIP_AHEAD, -held)
    arm_z = arm_z - model.GRIP_BELOW
    now_x, now_z = turn(turned, arm_x, arm_z)
    theta = pitch + turned
    x = -model.RADIUS - distance + ahead + now_x - arm_x
    z = sunk + now_z - arm_z
    z = z + jnp.maximum(0.0, options.clearance - (z + lowest(theta)))
    return jnp.stack([x, z, theta], -1)


def turn(angle: Array, x: Array, z: Array) -> tuple[Array, Array]:
    """`(x, z)` turned by `angle` about the lateral axis, nose down."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    return c * x + s * z, c * z - s * x


def lowest(theta: Array) -> Array:
    """Height of the blade's lowest edge over the tip's origin at pitch `theta`, m."""
    (cx, cz), (hx, hz) = model.BLADE_CENTRE, model.BLADE_HALF
    _, front = turn(theta, cx + hx, cz - hz)
    _, back = turn(theta, cx - hx, cz - hz)
    return jnp.minimum(front, back)


def from_tip(pose: Array, x: Array, z: Array) -> tuple[Array, Array]:
    """`(ahead, above)` m of a point `(x, z)` in the frame of the tip at `pose [..., 3]`."""
    return turn(-pose[..., 2], x - pose[..., 0], z - pose[..., 1])


KIND = TrialKind(
    "scoop",
    "scoops",
    "the piece",
    reach=2.0,
    fastest=3.0,
    slip=0.03,
    moves=0.01,
    ends=model.SECONDS,
    still=0.05,
    aside=0.10,
    never="the blade never came, or the track ends before",
    optional=("z",),
    usual=0.1,
)


@dataclass(frozen=True)
class WayCriteria:
    """What decides whether the frame of scoops is refused.

    Args:
        way: m that a piece must have gone for its way to count.
        ahead: Cosine of its way and the spatula's: less is another frame.
    """

    way: float = 0.03
    ahead: float = 0.5


WAY = WayCriteria()


def check_way(went: np.ndarray, where: str, names: Sequence[float]) -> None:
    """BadInput where pieces that went `went [N, 2 or more]` m did not go along the spatula's way:
    all, or one of them.
    """
    distant = np.linalg.norm(went[:, :2], axis=1) > WAY.way
    if not distant.any():
        return
    ahead = np.cos(np.arctan2(went[:, 1], went[:, 0]))
    middle = float(np.median(ahead[distant]))
    if middle < WAY.ahead:
        raise BadInput(
            f"{where}: pieces go {np.degrees(np.arccos(np.clip(middle, -1, 1))):.0f} degrees off "
            "the spatula's way: another frame? give tracks with x along it"
        )
    for k in np.flatnonzero(distant & (ahead < -WAY.ahead))[:1]:
        raise BadInput(
            f"{where}: trial {names[k]:g}: the piece goes against the spatula's way, the others go "
            "along it: the track of another frame? mend it, or leave that trial out"
        )
