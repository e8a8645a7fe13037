"""Logs of a double pendulum of the tests' own, many trials at once, to be spoiled in the ways that
loggers and people do.
"""

from pathlib import Path

import numpy as np

L1, L2, RATE = 0.35, 0.3, 100.0
META = (
    'task = "pendulum"\nmodel = "rigid_body"\nangle_zero = "hanging"\n\n'
    "[geometry]\nl1 = {l1}\nl2 = 0.3\ng = 9.81\n"
)


def _acceleration(q, v, tau, coulomb=0.0, tip=0.0):
    p1, p3, h1, h2, g = 0.16, 0.035, 0.33, 0.11, 9.81
    p1, p3 = p1 + tip * (L1**2 + L2**2), p3 + tip * L2**2
    h1, h2 = h1 + tip * L1, h2 + tip * L2
    c, s, pull = np.cos(q[:, 1]), np.sin(q[:, 1]), g * h2 * np.sin(q.sum(1))
    push1 = (
        tau[:, 0]
        + L1 * h2 * s * v[:, 1] * (2 * v[:, 0] + v[:, 1])
        - g * h1 * np.sin(q[:, 0])
        - pull
        - 0.03 * v[:, 0]
    )
    push2 = (
        tau[:, 1]
        - L1 * h2 * s * v[:, 0] ** 2
        - pull
        - 0.02 * v[:, 1]
        - coulomb * np.tanh(v[:, 1] / 0.01)
    )
    m11, m12 = p1 + 2 * L1 * h2 * c, p3 + L1 * h2 * c
    det = m11 * p3 - m12**2
    return np.stack([(p3 * push1 - m12 * push2) / det, (m11 * push2 - m12 * push1) / det], 1)


def arm(
    count: int = 4,
    seconds: float = 2.5,
    seed: int = 0,
    scale: float = 1.0,
    coulomb: float = 0.0,
    tip: float = 0.0,
) -> list[dict[str, np.ndarray]]:
    """`count` healthy trials: columns time, q1, q2, v1, v2, tau1, tau2, the torque held from row to
    row, with the sensors' noise; scale: of the torques, from 3 on joints go round; coulomb:
    friction of joint 2 in N m; tip: a load in kg.
    """
    rng = np.random.default_rng(seed)
    time = np.arange(int(seconds * RATE)) / RATE
    wave = rng.uniform(0.3, 2.5, (3, 1, count, 2)), rng.uniform(0, 6.3, (3, 1, count, 2))
    tau = (
        np.sin(2 * np.pi * wave[0] * time[:, None, None] + wave[1]).sum(0)
        * np.array([0.7, 0.25])
        * scale
    )
    q, v, rows, h = rng.uniform(-0.6, 0.6, (count, 2)), np.zeros((count, 2)), [], 1e-3
    for u in tau:
        rows.append(np.concatenate([q, v, u], 1))
        for _ in range(round(1 / RATE / h)):
            half = v + h / 2 * _acceleration(q, v, u, coulomb, tip)
            a = _acceleration(q + h / 2 * v, half, u, coulomb, tip)
            q, v = q + h * half, v + h * a
    table = np.array(rows) + rng.normal(size=(len(time), count, 6)) * [
        2e-4,
        2e-4,
        4e-3,
        4e-3,
        1e-3,
        1e-3,
    ]
    names = ("q1", "q2", "v1", "v2", "tau1", "tau2")
    return [
        {"time": time.copy()} | {name: table[:, i, k] for k, name in enumerate(names)}
        for i in range(count)
    ]


def wrapped(columns: dict, lost: int = 0) -> dict[str, np.ndarray]:
    """A trial with its angles in (-pi, pi], and without `lost` rows on either side of each place
    where they wrap.
    """
    angles = {k: (columns[k] + np.pi) % (2 * np.pi) - np.pi for k in ("q1", "q2")}
    keep = np.ones(len(columns["time"]), bool)
    for q in angles.values():
        for k in np.flatnonzero(np.abs(np.diff(q)) > np.pi) if lost else ():
            keep[max(0, k - lost) : k + lost] = False
    return {k: x[keep] for k, x in (columns | angles).items()}


def write(folder: Path, trials: list[dict], meta: str = META, l1: float = L1) -> Path:
    """A folder for `adaptsim diagnose`; cells that are text are written as they are."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "meta.toml").write_text(meta.format(l1=l1))
    for k, columns in enumerate(trials):

        def text(x):
            return x if isinstance(x, str) else f"{x:.12g}"

        rows = [
            ",".join(columns),
            *(",".join(map(text, row)) for row in zip(*columns.values(), strict=True)),
            "",
        ]
        (folder / f"{k:02d}.csv").write_text("\n".join(rows))
    return folder
