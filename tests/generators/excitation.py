"""Commands and starts of trials: multi-sines, chirps, random phases, free swings, tracking,
balancing.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm, solve_discrete_are

from tests.generators.worlds import G, Rig, lanes_of, mass_matrix

OPEN_KINDS = ("multisine", "tracking", "chirp", "swing", "random_phase", "tracking")


@dataclass
class Trial:
    """One trial's drive. times `[K]`, feedforward `[K, 2]`, gain `[2, 4]`, reference `[K, 4]`,
    start `[4]`.
    """

    kind: str
    times: np.ndarray
    feedforward: np.ndarray
    gain: np.ndarray
    reference: np.ndarray
    start: np.ndarray


def sines(rng: np.random.Generator, t: np.ndarray, low: float, high: float, count: int):
    """A random-phase sum of sines of unit RMS and its derivative, each `[K]`."""
    f = np.exp(rng.uniform(np.log(low), np.log(high), count))
    w = 2 * np.pi * f
    a = rng.uniform(0.5, 1.0, count) / np.sqrt(f / low)
    a *= np.sqrt(2 / np.sum(a**2))
    phase = rng.uniform(0, 2 * np.pi, count)
    angle = t[:, None] * w + phase
    return np.sin(angle) @ a, np.cos(angle) @ (a * w)


def chirp(rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """A sweep of unit RMS from 0.2-0.5 Hz to 2-4 Hz over the trial, `[K]`."""
    f0, f1 = rng.uniform(0.2, 0.5), rng.uniform(2.0, 4.0)
    phase = 2 * np.pi * (f0 * t + 0.5 * (f1 - f0) * t**2 / max(t[-1], 1e-9))
    return np.sqrt(2) * np.sin(phase + rng.uniform(0, 2 * np.pi))


def torques(rng: np.random.Generator, kind: str, t: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Open-loop torques `[K, 2]` of RMS about `scale` per joint, faded in over 0.3 s."""
    if kind == "chirp":
        out = np.stack([chirp(rng, t) for _ in range(2)], 1)
    else:
        count = 12 if kind == "random_phase" else 4
        out = np.stack([sines(rng, t, 0.25, 3.0, count)[0] for _ in range(2)], 1)
    return out * scale * np.minimum(1.0, t / 0.3)[:, None]


def mass_at_rest(rig: Rig) -> np.ndarray:
    """Mass matrix `[2, 2]` at q2 = 0."""
    m11, m12, m22 = (
        float(np.squeeze(x)) for x in mass_matrix(lanes_of([rig], [1]), np.zeros((2, 1)))
    )
    return np.array([[m11, m12], [m12, m22]])


def balance_gain(rng: np.random.Generator, rig: Rig, dt: float) -> np.ndarray:
    """Discrete LQR gain about upright at the trial's rate, for a rig known only to 10 %, `[2,
    4]`.
    """
    p = lanes_of([rig], [1])
    lower = float(p.a3[0])
    first = rig.m[0] + 2 * rig.m[1] if p.linear else float(p.a4[0]) + lower
    second = rig.m[1] if p.linear else lower
    stiffness = G * np.array([[first, second], [second, second]])
    inverse = np.linalg.inv(mass_at_rest(rig) * rng.uniform(0.92, 1.08))
    system = np.zeros((6, 6))
    system[:2, 2:4] = np.eye(2)
    system[2:4, :] = np.hstack([inverse @ stiffness, -inverse @ np.diag(rig.b), inverse])
    held = expm(system * dt)
    a, b = held[:4, :4], held[:4, 4:]
    cost = np.eye(2) if p.linear else np.diag(1.0 / rig.gravity_torque() ** 2)
    q = np.eye(4) if p.linear else np.diag([20.0, 20.0, 0.5, 0.5])
    s = solve_discrete_are(a, b, q, cost)
    return np.linalg.solve(cost + b.T @ s @ b, b.T @ s @ a)


def tracking_gain(rng: np.random.Generator, rig: Rig, dt: float) -> np.ndarray:
    """A PD gain `[2, 4]` of a few times the gravity torque, soft enough for the trial's rate."""
    scale = rig.gravity_torque()
    mass = mass_at_rest(rig)
    least = np.linalg.det(mass) / np.diag(mass)[::-1]
    kp = np.minimum(scale * rng.uniform(2.0, 5.0, 2), least * (0.4 / dt) ** 2)
    kd = np.sqrt(kp * (rig.inertia + rig.m * rig.c**2)) * rng.uniform(0.6, 1.2, 2)
    return np.hstack([np.diag(kp), np.diag(np.minimum(kd, 0.4 * least / dt))])


def make_trial(rng: np.random.Generator, rig: Rig, kind: str, t: np.ndarray) -> Trial:
    """One trial of the given kind on this rig."""
    zero, gain = np.zeros((len(t), 2)), np.zeros((2, 4))
    rest, start = np.zeros((len(t), 4)), np.zeros(4)
    scale = rig.gravity_torque()
    if kind in ("balance", "open_upright"):
        return _upright(rng, rig, kind, t)
    home = np.array([0.0 if rig.sign > 0 else np.pi, 0.0, 0.0, 0.0])
    start[:2] = rng.uniform(-0.2, 0.2, 2)
    if kind == "swing":
        start[:2] = rng.uniform(0.5, [1.9, 1.3]) * rng.choice([-1, 1], 2)
        return Trial(kind, t, zero, gain, rest, start + home)
    if kind == "tracking":
        gain = tracking_gain(rng, rig, float(np.median(np.diff(t))))
        for j in range(2):
            value, slope = sines(rng, t, 0.2, 1.3, 5)
            size = rng.uniform(0.3, 0.65)
            rest[:, j], rest[:, 2 + j] = size * value, size * slope
        return Trial(kind, t, zero, gain, rest + home, rest[0] + home)
    push = torques(rng, kind, t, scale * rng.uniform(0.25, 0.5, 2))
    return Trial(kind, t, push, gain, rest, start + home)


def _upright(rng: np.random.Generator, rig: Rig, kind: str, t: np.ndarray) -> Trial:
    """About upright: balanced by LQR with extra torques, or let go for as long as the trial
    lasts.
    """
    gain = (
        balance_gain(rng, rig, float(np.median(np.diff(t))))
        if kind == "balance"
        else np.zeros((2, 4))
    )
    size = (0.3 if rig.world == "linearized" else 0.15) * rng.uniform(0.7, 1.3)
    push = torques(
        rng, str(rng.choice(["multisine", "random_phase", "chirp"])), t, rig.gravity_torque() * size
    )
    wide = 1.0 if rig.world == "linearized" and kind == "balance" else 0.15
    start = rng.uniform(-wide, wide, 4) * [1.0, 0.6, 0.5, 0.5]
    reference = np.zeros((len(t), 4))
    for j in range(2):
        value, slope = sines(rng, t, 0.15, 1.0, 4)
        size = rng.uniform(0.1, 0.3)
        reference[:, j], reference[:, 2 + j] = size * value, size * slope
    return Trial(kind, t, push, gain, reference, start)
