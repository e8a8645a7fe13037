"""Does the motion fit the declared convention: a linear regression of torque on rigid-body
regressors.

The double pendulum's inverse dynamics is linear in its base parameters (Khalil and Dombre 2002, ch.
9). With the angle zero or the unit declared wrongly, gravity has the wrong sign, or a converted
angle fits better.
"""

import math

import numpy as np

from adaptsim_jax.core.constants import GRAVITY
from adaptsim_jax.logs.quality.findings import Finding
from adaptsim_jax.logs.types import Recording, Trial

MOST_ROWS = 4000


def regressors(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """`[2 T, 10]`: inertia (2), coupling, gravity (2; above 0 restores), damping, dry friction,
    bias.
    """
    n = len(q)
    c2, s2 = np.cos(q[:, 1]), np.sin(q[:, 1])
    a1, a2, v1, v2 = a[:, 0], a[:, 1], v[:, 0], v[:, 1]
    zero = np.zeros(n)
    loud = 0.02 * max(float(np.max(np.abs(v))), 1e-9)
    first = [
        a1,
        a1 + a2,
        c2 * (2 * a1 + a2) - s2 * (2 * v1 * v2 + v2**2),
        np.sin(q[:, 0]),
        np.sin(q[:, 0] + q[:, 1]),
        v1,
        zero,
        np.tanh(v1 / loud),
        zero,
        np.ones(n),
    ]
    second = [zero, a1 + a2, c2 * a1 + s2 * v1**2, zero, np.sin(q[:, 0] + q[:, 1]), zero, v2, zero]
    second += [np.tanh(v2 / loud), zero]
    return np.concatenate([np.stack(first, axis=1), np.stack(second, axis=1)])


def _motion(trial: Trial) -> tuple[np.ndarray, ...]:
    """Angle, velocity, acceleration and torque, low-passed alike by means over short blocks (about
    30 ms).
    """
    block = max(1, round(0.03 / trial.dt))
    n = len(trial.time) // block
    if n < 8:
        return (np.zeros((0, 2)),) * 4

    def mean(x: np.ndarray) -> np.ndarray:
        return x[: n * block].reshape(n, block, -1).mean(axis=1)

    time = mean(trial.time)[:, 0]
    q = mean(trial.q)
    v = np.gradient(q, time, axis=0) if trial.v is None else mean(trial.v)
    return q[1:-1], v[1:-1], np.gradient(v, time, axis=0)[1:-1], mean(trial.torque)[1:-1]


def gravity_fit(recording: Recording, scale: float = 1.0) -> tuple[np.ndarray, np.ndarray, float]:
    """Base parameters `[10]`, t-values `[10]` and R2 with angles times `scale`; R2 is 0 without
    torque.
    """
    parts = [_motion(t) for t in recording.trials]
    q, v, a, u = (np.concatenate([p[k] for p in parts])[:MOST_ROWS] for k in range(4))
    target = np.concatenate([u[:, 0], u[:, 1]])
    total = float(np.sum(target**2))
    if len(q) < 30 or total < 1e-12:
        return np.zeros(10), np.zeros(10), 0.0
    design = regressors(q * scale, v * scale, a * scale)
    size = np.maximum(np.sqrt(np.mean(design**2, axis=0)), 1e-12)
    u_, s_, vt = np.linalg.svd(design / size, full_matrices=False)
    keep = s_ > 1e-6 * s_[0]
    inverse = (vt[keep].T / s_[keep]) @ u_[:, keep].T
    theta = inverse @ target
    rest = target - design / size @ theta
    # Neighbouring rows err alike: a tenth of them is taken as independent.
    variance = float(np.sum(rest**2)) / max(len(target) - 10, 1) * 10.0
    spread = np.sqrt(np.maximum(np.sum(inverse**2, axis=1) * variance, 1e-300))
    return theta / size, theta / spread, 1.0 - float(np.sum(rest**2)) / total


def check_angle_zero(recording: Recording) -> list[Finding]:
    """Warn where gravity pushes the other way than the declared `angle_zero` says (rigid-body model
    only).
    """
    if recording.model != "rigid_body" or recording.geometry.get("g", GRAVITY) == 0:
        return []
    theta, t_value, r2 = gravity_fit(recording)
    sign = 1.0 if recording.angle_zero == "hanging" else -1.0
    joints = [(sign * theta[k], sign * t_value[k]) for k in (3, 4)]
    if r2 < 0.5 or not any(t < -8 for _, t in joints) or any(t > 3 for _, t in joints):
        return _resting(recording)
    other = "upright" if recording.angle_zero == "hanging" else "hanging"
    text = f"gravity acts as if angles were zero when {other}, meta.toml says {recording.angle_zero}: check it"
    return [Finding("angle_zero", "warn", "", "meta.toml", text, float(min(t for _, t in joints)))]


def _resting(recording: Recording) -> list[Finding]:
    """At rest without torque the arm hangs (or stands): link 1 must be near 0 or half a turn from
    it.
    """
    for trial in recording.trials:
        n = min(20, len(trial.time))
        still = np.all(np.ptp(trial.q[:n], axis=0) < 0.003) and np.all(
            np.abs(trial.torque[:n]) < 1e-3
        )
        if not still or np.ptp(trial.q) < 0.02:
            continue
        tilt = [float(abs(math.remainder(x, math.pi))) for x in (trial.q[0, 0], trial.q[0].sum())]
        if max(tilt) > 0.6:
            at = f"q = {trial.q[0, 0]:.3g}, {trial.q[0, 1]:.3g} rad"
            text = f"at rest without torque at {at}, which gravity forbids: check angle_zero"
            return [Finding("angle_zero", "warn", trial.name, "meta.toml", text, max(tilt))]
    return []
