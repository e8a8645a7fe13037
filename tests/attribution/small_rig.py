"""A small recording for tests of the closed loop, made with SciPy's integrator and equations
written out here.
"""

from types import SimpleNamespace

import numpy as np
from scipy.integrate import solve_ivp

TRUE = np.array([0.12, 0.03, 0.30, 0.11, 0.06, 0.03])  # p1, p3, h1, h2, b1, b2
GEOMETRY = {"l1": 0.3, "l2": 0.25, "g": 9.81}
SIGMA = np.array([1e-3, 1e-3, 2e-2, 2e-2])


def acceleration(theta, q, v, torque):
    """Joint accelerations of a hanging rigid double pendulum in base parameters."""
    p1, p3, h1, h2, b1, b2 = theta
    c2, s2 = np.cos(q[1]), np.sin(q[1])
    l1, g = GEOMETRY["l1"], GEOMETRY["g"]
    mass = np.array([[p1 + 2 * l1 * h2 * c2, p3 + l1 * h2 * c2], [p3 + l1 * h2 * c2, p3]])
    lower = g * h2 * np.sin(q[0] + q[1])
    rest = np.array(
        [
            -l1 * h2 * s2 * v[1] * (2 * v[0] + v[1]) + g * h1 * np.sin(q[0]) + lower + b1 * v[0],
            l1 * h2 * s2 * v[0] ** 2 + lower + b2 * v[1],
        ]
    )
    return np.linalg.solve(mass, torque - rest)


def make_trials(
    seed=0, count=3, seconds=2.0, rate=200.0, noise=1.0, extra=None, velocity=True, theta=TRUE
):
    """Trials with torques held over each row and Gaussian sensor noise; `extra(t, q, v, u) -> [2]`
    N m is hidden.
    """
    rng = np.random.default_rng(seed)
    return [_trial(rng, seconds, rate, noise, extra, velocity, theta) for _ in range(count)]


def _trial(rng, seconds, rate, noise, extra, velocity, theta):
    time = np.arange(0, seconds, 1 / rate)
    phase, freq = rng.uniform(0, 2 * np.pi, (2, 4)), rng.uniform(0.3, 2.5, (2, 4))
    waves = np.sin(2 * np.pi * freq[..., None] * time + phase[..., None]).sum(1)
    torque = (waves * np.array([[0.35], [0.15]])).T
    x = np.concatenate([rng.uniform(-0.5, 0.5, 2), np.zeros(2)])
    states = [x]
    for k in range(len(time) - 1):
        u = torque[k]

        def deriv(t, x, u=u):
            force = u + (0.0 if extra is None else extra(t, x[:2], x[2:], u))
            return np.concatenate([x[2:], acceleration(theta, x[:2], x[2:], force)])

        x = solve_ivp(deriv, (time[k], time[k + 1]), x, rtol=1e-8, atol=1e-10).y[:, -1]
        states.append(x)
    y = np.array(states) + noise * SIGMA * rng.standard_normal((len(time), 4))
    return SimpleNamespace(time=time, q=y[:, :2], v=y[:, 2:] if velocity else None, torque=torque)


def written(folder, trials, l1=GEOMETRY["l1"]):
    """The trials as a folder of CSV files, angles and torques alone, with `l1` as the declared
    length of the first link.
    """
    for i, t in enumerate(trials):
        rows = np.column_stack([t.time, t.q, t.torque])
        np.savetxt(
            folder / f"t{i}.csv",
            rows,
            delimiter=",",
            header="time,q1,q2,tau1,tau2",
            comments="",
            fmt="%.9g",
        )
    lengths = f"[geometry]\nl1 = {l1}\nl2 = {GEOMETRY['l2']}\ng = {GEOMETRY['g']}\n"
    (folder / "meta.toml").write_text(
        f'task = "pendulum"\nmodel = "rigid_body"\nangle_zero = "hanging"\n{lengths}'
    )
    return folder
