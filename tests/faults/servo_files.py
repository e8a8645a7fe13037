"""Logs of legs that hang side by side, each under a servo: a machine of the tests' own, and what
loggers and drivers do to its logs.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.logs.log_files import folder

MASS, LENGTH, DAMPING, G = 0.5, 0.3, 0.05, 9.81
KP, KV = 15.0, 0.8


def model(names: tuple[str, ...], actuators: tuple[str, ...] = (), kind: str = "position") -> str:
    """MJCF of the legs; actuators: the joints in the order of the actuators; kind: position
    (servos) or motor.
    """
    law = f'kp="{KP}" kv="{KV}"' if kind == "position" else ""
    bodies = "".join(
        f'<body pos="0 {k} 0"><joint name="{name}" axis="0 1 0" damping="{DAMPING}"/>'
        f'<inertial pos="0 0 {-LENGTH / 2}" mass="{MASS}" diaginertia="{MASS * LENGTH**2 / 12} '
        f'{MASS * LENGTH**2 / 12} 1e-4"/></body>'
        for k, name in enumerate(names)
    )
    told = "".join(f'<{kind} name="p_{name}" joint="{name}" {law}/>' for name in actuators or names)
    return f"<mujoco><worldbody>{bodies}</worldbody><actuator>{told}</actuator></mujoco>"


def swung(
    target: np.ndarray,
    rate: float,
    gain: float = 1.0,
    sent: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray] | None = None,
) -> np.ndarray:
    """Angles `[T, n]` of legs whose servos are given rows of `target [T, n]`; gain: of the servos,
    over what the file says; sent(target, last sent, angle): what the driver makes of a target.
    """
    inertia, pull = MASS * LENGTH**2 / 3, MASS * G * LENGTH / 2
    q, v, last, out = target[0].copy(), np.zeros(target.shape[1]), target[0].copy(), []
    fine = max(1, round(1e3 / rate))
    h = 1.0 / rate / fine
    for u in target:
        out.append(q.copy())
        last = u if sent is None else sent(u, last, q)

        def acc(q, v, u=last):
            return (gain * KP * (u - q) - (KV + DAMPING) * v - pull * np.sin(q)) / inertia

        for _ in range(fine):
            a = acc(q, v)
            half = v + h / 2 * a
            b = acc(q + h / 2 * v, half)
            q, v = q + h * half, v + h * b
    return np.array(out)


def sines(seed: int, rows: int, rate: float, joints: int, size: float = 0.5) -> np.ndarray:
    """Targets `[rows, joints]`."""
    rng = np.random.default_rng(seed)
    f, phase = rng.uniform(0.3, 2.0, (4, joints)), rng.uniform(0, 2 * np.pi, (4, joints))
    t = np.arange(rows)[:, None, None] / rate
    return size * 0.6 * np.sin(2 * np.pi * f * t + phase).sum(1)


def steps(seed: int, rows: int, hold: int, size: float = 0.6) -> np.ndarray:
    """Targets `[rows, 1]` that step."""
    return np.repeat(np.random.default_rng(seed).uniform(-size, size, rows // hold + 1), hold)[
        :rows, None
    ]


def noisy(q: np.ndarray, seed: int) -> np.ndarray:
    return q + 1e-4 * np.random.default_rng(1000 + seed).normal(size=q.shape)


def log(
    path: Path,
    meta: str,
    names: tuple[str, ...],
    trials: list[tuple[np.ndarray, np.ndarray, np.ndarray]],
) -> Path:
    """A folder of trials (time, angles, targets) with its model beside meta.toml."""
    columns = {
        f"run_{k}": {"time": t}
        | {f"q_{n}": q[:, j] for j, n in enumerate(names)}
        | {f"target_{n}": u[:, j] for j, n in enumerate(names)}
        for k, (t, q, u) in enumerate(trials)
    }
    made = folder(path, 'model = "robot.xml"\n' + meta, **columns)
    (path / "robot.xml").write_text(model(names))
    return made
