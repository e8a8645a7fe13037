"""Recordings for the tests of reading, audit and noise: a double pendulum integrated by SciPy, in
files.
"""

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

META = """task = "pendulum"
model = "rigid_body"
angle_zero = "hanging"

[geometry]
l1 = 0.3
l2 = 0.2
g = 9.81
"""
M1, M2, R1, R2, I1, I2, B1, B2, L1, G = 0.6, 0.5, 0.2, 0.15, 0.01, 0.006, 0.02, 0.015, 0.3, 9.81


def acceleration(q, v, u, coulomb):
    """Joint accelerations of a two-link arm hanging from its base, with viscous and dry
    friction.
    """
    c2, s2 = np.cos(q[1]), np.sin(q[1])
    coupling = M2 * L1 * R2
    m22 = I2 + M2 * R2**2
    m12 = m22 + coupling * c2
    m11 = I1 + M1 * R1**2 + M2 * L1**2 + m22 + 2 * coupling * c2
    g2 = M2 * R2 * G * np.sin(q[0] + q[1])
    f1 = (
        u[0]
        + coupling * s2 * (2 * v[0] * v[1] + v[1] ** 2)
        - (M1 * R1 + M2 * L1) * G * np.sin(q[0])
        - g2
    )
    f2 = u[1] - coupling * s2 * v[0] ** 2 - g2
    f1 -= B1 * v[0] + coulomb * np.tanh(v[0] / 0.02)
    f2 -= B2 * v[1] + coulomb * np.tanh(v[1] / 0.02)
    det = m11 * m22 - m12**2
    return np.array([(m22 * f1 - m12 * f2) / det, (m11 * f2 - m12 * f1) / det])


def simulate(seed, seconds=4.0, rate=200.0, strength=0.3, jitter=0.0, coulomb=0.0):
    """`(time [T], q [T, 2], v [T, 2], torque [T, 2])` of one trial; torques held from row to
    row.
    """
    rng = np.random.default_rng(seed)
    n = int(seconds * rate)
    time = (np.arange(n) + jitter * rng.uniform(-0.5, 0.5, n)) / rate
    freq, phase = rng.uniform(0.2, 1.8, (2, 3)), rng.uniform(0, 2 * np.pi, (2, 3))
    waves = np.sin(2 * np.pi * freq * time[:, None, None] + phase)
    torque = waves.sum(axis=2) * strength * np.array([1.0, 0.5])
    state, states = np.r_[rng.uniform(-0.3, 0.3, 2), 0.0, 0.0], []
    for k in range(n):
        states.append(state)
        if k + 1 < n:
            span = (time[k], time[k + 1])

            def rates(t, x, u=torque[k]):
                return np.r_[x[2:], acceleration(x[:2], x[2:], u, coulomb)]

            state = solve_ivp(rates, span, state, method="DOP853", rtol=1e-6, atol=1e-8).y[:, -1]
    states = np.array(states)
    return time, states[:, :2], states[:, 2:], torque


def table(time, q, v=None, torque=None):
    """Columns by the names of the files."""
    columns = {"time": time, "q1": q[:, 0], "q2": q[:, 1]}
    if v is not None:
        columns |= {"v1": v[:, 0], "v2": v[:, 1]}
    if torque is not None:
        columns |= {"tau1": torque[:, 0], "tau2": torque[:, 1]}
    return columns


def csv_text(columns, delimiter=",", newline="\n"):
    """CSV text of the columns at full precision."""
    rows = [delimiter.join(columns)]
    rows += [
        delimiter.join(repr(float(x)) for x in row) for row in zip(*columns.values(), strict=True)
    ]
    return newline.join(rows) + newline


def write(folder, trials, meta=META):
    """Write `{name: columns}` and the meta text into `folder`; returns the folder."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "meta.toml").write_text(meta)
    for name, columns in trials.items():
        (folder / f"{name}.csv").write_text(csv_text(columns))
    return folder


def real_rig(name):
    """The folder of a real recording, or a visible skip where the data is not at hand."""
    return measured(f"measured_double_pendulum/{name}")


def measured(name):
    """A folder of real recordings, or a visible skip where the data is not at hand."""
    root = Path(__file__).resolve().parents[2]
    folder = Path(os.environ.get("ADAPTSIM_DATA", root.parent / "shared" / "data")) / name
    if not folder.is_dir():
        pytest.skip(
            f"real recording {folder.name} is not at hand: set ADAPTSIM_DATA to the folder that "
            "holds it"
        )
    return folder
