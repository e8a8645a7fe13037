"""JointTrajectory messages as controllers act on them (ros_control's and ros2_control's
joint_trajectory_controller): a new one takes the place of what of the old lies ahead, joint by
joint, and points are ramped to, by splines where they have speeds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from adaptsim_jax.logs.clock import Series
from adaptsim_jax.logs.messages import nanoseconds

FINE = 16
"""Pieces into which a spline between two points is cut: a controller's rows are no shorter."""
STEP = 1e-9
"""s that a step takes: less than any row."""
Angle = Callable[[str, float], float]
"""Where a joint is measured to be at a time (s)."""


@dataclass(frozen=True)
class Plan:
    """A trajectory of some joints: `begin` s, from which points count; `comes` s, when it is known;
    points (s, angles, speeds).
    """

    begin: float
    comes: float
    joints: tuple[str, ...]
    points: tuple[tuple[float, np.ndarray, np.ndarray], ...]

    @property
    def takes_over(self) -> float:
        return max(self.begin, self.comes)


def plan_of(message: Any, stamp: float | None, comes: float) -> Plan:
    """A message of a trajectory or of an action's goal.

    Args:
        stamp: Its own time, None where it has none and so begins as it comes.
    """
    inner = message.goal.trajectory if hasattr(message, "goal") else message
    begin = comes if stamp is None else stamp
    points = tuple(
        (
            begin + nanoseconds(p.time_from_start) * 1e-9,
            np.asarray(p.positions, float),
            np.asarray(p.velocities, float),
        )
        for p in inner.points
    )
    return Plan(begin, comes, tuple(inner.joint_names), points)


def followed_commands(plans: Sequence[Plan], angle: Angle, hold: bool) -> list[Series]:
    """What is commanded to each joint.

    Args:
        hold: Each point from its time to the next, else moved to meanwhile.
        angle: Where a joint is before its first command.
    """
    plans = sorted(plans, key=lambda plan: plan.takes_over)
    joints = dict.fromkeys(joint for plan in plans for joint in plan.joints)
    out = []
    for joint in joints:
        joint_plans = [plan for plan in plans if joint in plan.joints or not plan.joints]
        if hold:
            time, value = _held_points(joint_plans, joint, angle)
        else:
            time, value = _ramped_points(joint_plans, joint, angle)
        if len(time):
            out.append(
                Series(np.array(time), {f"target_{joint}": np.array(value)}, is_linear=not hold)
            )
    return out


def sample_and_hold(series: Series, rows: np.ndarray) -> Series:
    """What moves from point to point as a controller has it that looks at `rows [T]` s, and holds
    what it has between them.
    """
    time = np.unique(rows[rows > series.time[0]])
    time = np.concatenate([series.time[:1], time])
    columns = {
        name: np.interp(time, series.time, values) for name, values in series.columns.items()
    }
    return Series(time, columns)


Point = tuple[float, float, float]


def _points(plan: Plan, joint: str) -> tuple[list[Point], list[Point]]:
    """Time, angle and speed of a joint's points that are past when a trajectory takes over, and of
    those ahead.
    """
    if joint not in plan.joints:
        return [], []
    j, n_joints = plan.joints.index(joint), len(plan.joints)

    def speed(v):
        if len(v) == n_joints:
            return float(v[j])
        return np.nan

    points = [(t, float(q[j]), speed(v)) for t, q, v in plan.points if len(q) == n_joints]
    return [p for p in points if p[0] <= plan.takes_over], [
        p for p in points if p[0] > plan.takes_over
    ]


def _held_points(
    plans: Sequence[Plan], joint: str, angle: Angle
) -> tuple[list[float], list[float]]:
    time: list[float] = []
    value: list[float] = []
    for plan in plans:
        start = plan.takes_over
        k = int(np.searchsorted(time, start))
        current = value[k - 1] if k else None
        time, value = time[:k], value[:k]
        passed, ahead = _points(plan, joint)
        if passed:
            ahead = [(start, *passed[-1][1:]), *ahead]
        elif current is None:
            ahead = [(start, angle(joint, start), 0.0), *ahead]
        time += [p[0] for p in ahead]
        value += [p[1] for p in ahead]
    return time, value


def _ramped_points(
    plans: Sequence[Plan], joint: str, angle: Angle
) -> tuple[list[float], list[float]]:
    time: list[float] = []
    value: list[float] = []
    for plan in plans:
        start = plan.takes_over
        if time:
            current = float(np.interp(start, time, value))
        else:
            current = angle(joint, start)
        k = int(np.searchsorted(time, start))
        if 0 < k < len(time):
            speed = (value[k] - value[k - 1]) / (time[k] - time[k - 1])
        else:
            speed = 0.0
        is_first = not time
        time, value = time[:k], value[:k]
        passed, ahead = _points(plan, joint)
        if passed and not ahead:  # no time to move is given: a step
            time = [*time, start, start + STEP] if not is_first else [start]
            if not is_first:
                value = [*value, current, passed[-1][1]]
            else:
                value = [passed[-1][1]]
            continue
        if passed and is_first:
            (t0, q0, _), (t1, q1, _) = passed[-1], ahead[0]
            current = float(np.interp(start, [t0, t1], [q0, q1]))
        time, value = [*time, start], [*value, current]
        for (t0, q0, v0), (t1, q1, v1) in zip(
            [(start, current, speed), *ahead], ahead, strict=False
        ):
            if np.isfinite(v1) and np.isfinite(v0):
                s = np.linspace(0.0, 1.0, FINE + 1)[1:]
                h = t1 - t0
                from_start = q0 * (2 * s**3 - 3 * s**2 + 1) + h * v0 * (s**3 - 2 * s**2 + s)
                curve = from_start + q1 * (3 * s**2 - 2 * s**3) + h * v1 * (s**3 - s**2)
                time += (t0 + h * s).tolist()
                value += curve.tolist()
            else:
                time.append(t1)
                value.append(q1)
    return time, value
