"""What moves the machines: references of few sines or a chirp, followed by a torque controller or
by position servos; pushes.
"""

import mujoco
import numpy as np

from tests.generators.excitation import sines
from tests.generators.mechanism_engine import STEP, Drive
from tests.generators.mechanism_machines import Machine

FREE = ("pendulum", "double_pendulum")
"""Machines that hang at rest and are also pushed by plain torques, or let go."""


def sweep(rng: np.random.Generator, t: np.ndarray, low: float, high: float):
    """A chirp of amplitude 1 and its derivative."""
    phase = 2 * np.pi * (low * t + 0.5 * (high - low) * t**2 / t[-1]) + rng.uniform(0, 2 * np.pi)
    return np.sin(phase), np.cos(phase) * 2 * np.pi * (low + (high - low) * t / t[-1])


def wave(rng: np.random.Generator, t: np.ndarray, kind: str):
    """A reference of peak 1 and its derivative, `[R]` each."""
    if kind == "chirp":
        x, y = sweep(rng, t, rng.uniform(0.1, 0.25), rng.uniform(0.9, 1.5))
        y = (
            y * (shape := 1 / (1 + (0.6 * t / t[-1]) ** 2))
            - x * 1.2 * 0.6 * t / t[-1] ** 2 * shape**2
        )
        return x * shape, y
    x, y = sines(rng, t, 0.15, 1.2, 6)
    peak = np.abs(x).max()
    return x / peak, y / peak


def inertia(model: mujoco.MjModel, q: np.ndarray) -> np.ndarray:
    """What each joint feels of inertia with the others free to move, [n]."""
    d = mujoco.MjData(model)
    d.qpos[:] = q
    mujoco.mj_forward(model, d)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, d, full)
    return 1 / np.diag(np.linalg.inv(full))


def weight(model: mujoco.MjModel, q: np.ndarray) -> np.ndarray:
    """Force of gravity `[R, n]` at angles `[R, n]`, to be held by the actuators."""
    d, out = mujoco.MjData(model), np.zeros(q.shape)
    for k, x in enumerate(q):
        d.qpos[:] = x
        mujoco.mj_kinematics(model, d)
        mujoco.mj_comPos(model, d)
        mujoco.mj_comVel(model, d)
        mujoco.mj_rne(model, d, 0, out[k])
    return out


def servo_gains(rng: np.random.Generator, machine: Machine, model: mujoco.MjModel) -> np.ndarray:
    """kp and kv `[n, 2]` of position servos: 3 to 5 Hz at the home pose, zero where nothing
    drives.
    """
    own = inertia(model, home(machine))
    w = 2 * np.pi * rng.uniform(3.0, 5.0, machine.n)
    out = np.stack([own * w**2, 2 * rng.uniform(0.4, 0.8, machine.n) * w * own], 1)
    out[[j for j in range(machine.n) if j not in machine.driven]] = 0
    return out


def home(machine: Machine) -> np.ndarray:
    return np.array([link.home for link in machine.links])


def _rows(rng, duration: float, rate: int, uneven: bool) -> np.ndarray:
    apart = round(1 / rate / STEP)
    rows = np.arange(round(duration * rate)) * apart
    if uneven:
        rows[1:-1] += rng.integers(-1, 2, len(rows) - 2)
    return rows


def make_drive(
    rng: np.random.Generator,
    machine: Machine,
    declared: mujoco.MjModel,
    mode: str,
    wide: float = 1.0,
) -> Drive:
    """6 to 8 trials of 5 to 6 s at 200 or 250 Hz. wide: share of the machine's reach."""
    trials, rate = int(rng.integers(6, 9)), int(rng.choice([200, 250]))
    duration, uneven = rng.uniform(5.0, 6.0), bool(rng.integers(2))
    parts = []
    for k in range(trials):
        rows = _rows(rng, duration, rate, uneven)
        kinds = (
            ("track", "chirp", "push", "track", "swing", "push")
            if machine.name in FREE and mode == "torque"
            else ("track", "chirp", "track")
        )
        parts.append(
            (rows, *_trial(rng, machine, declared, mode, kinds[k % len(kinds)], rows * STEP, wide))
        )
    fields = [np.stack(z) for z in zip(*parts, strict=True)]
    shape = fields[0].shape
    fine = np.exp(rng.uniform(np.log(1e-4), np.log(1e-3))) * np.array(
        [0.3 if link.kind == "slide" else 1.0 for link in machine.links]
    )
    rough = np.exp(rng.uniform(np.log(5.0), np.log(20.0))) * fine
    noise = rng.normal(size=(*shape, 2, machine.n)) * np.stack([fine, rough])
    return Drive(*fields, noise)


def _trial(rng, machine: Machine, declared, mode: str, kind: str, t: np.ndarray, wide: float):
    """(start, reference, slope, feed, gains)."""
    n, rest = machine.n, home(machine)
    driven = np.isin(np.arange(n), machine.driven)
    reference, slope, feed = (np.zeros((len(t), n)) for _ in range(3))
    gains, start, fade = np.zeros((2, n)), rest.copy(), np.minimum(1, t / 0.3)[:, None]
    scale = np.abs(
        weight(declared, rest + 0.5 * np.eye(n) * [link.reach for link in machine.links])
    ).max(0)
    own = inertia(declared, rest)
    if kind in ("track", "chirp"):
        for j in machine.driven:
            size = wide * machine.links[j].reach * rng.uniform(0.75, 1.0)
            x, y = wave(rng, t, kind)
            reference[:, j], slope[:, j] = rest[j] + size * x, size * y
        start[driven] = reference[0, driven] + rng.normal(0, 0.02, driven.sum())
        if mode == "torque":
            w = 2 * np.pi * rng.uniform(1.2, 2.0, n)
            gains = np.stack([own * w**2, 2 * rng.uniform(0.4, 0.8, n) * w * own])
            if machine.name not in FREE:
                feed = weight(declared, np.where(driven, reference, rest))
            shake = np.stack([sines(rng, t, 0.5, 5.0, 6)[0] for _ in range(n)], 1)
            feed = feed + fade * shake * 0.15 * (own * w**2 * 0.4 + scale) * wide
    elif kind == "push":
        push = np.stack([sines(rng, t, 0.25, 3.0, 6)[0] for _ in range(n)], 1)
        feed = fade * push * scale * rng.uniform(0.3, 0.6, n) * wide
        gains = np.stack(
            [scale * rng.uniform(0.2, 0.5, n), 0.15 * np.sqrt(own * scale)]
        )  # lest it turn over
        start += rng.uniform(-0.3, 0.3, n)
    else:
        start += rng.uniform(0.6, 1.3, n) * rng.choice([-1, 1], n) * wide
    free = ~driven
    start[free] = rest[free] + rng.uniform(0.3, 1.0, free.sum()) * rng.choice([-1, 1], free.sum())
    return start, reference, slope, feed, gains
