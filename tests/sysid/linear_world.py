"""A double integrator pushed by a known force, written out by hand: the ground truth of the residual statistics."""

import numpy as np

from adaptsim_jax.sysid.estimate.variance import Linearised

DT, ROWS, SIGMA = 0.01, 40, 1e-3


def make(rng: np.random.Generator, *, windows=40, trials=4, force_std=0.0, tau=0.1, effect=0.0, noise=1.0):
    """One joint seen through q; declared parameters: a damping and a constant gain; one candidate: sign(v)."""
    phi = np.array([[1.0, DT], [0.0, 1.0]])
    gamma = np.array([0.5 * DT**2, DT])
    reach = np.zeros((ROWS + 1, 2, ROWS))
    for k in range(ROWS):
        reach[k + 1] = phi @ reach[k]
        reach[k + 1, :, k] += gamma
    impulse = reach[:, 0] / SIGMA
    jac_state = np.stack([np.ones(ROWS + 1), DT * np.arange(ROWS + 1)], -1) / SIGMA
    t = DT * np.arange(ROWS)[None] + 0.4 * np.arange(windows)[:, None]
    speed = np.sin(2.1 * t + 0.5) + 0.7 * np.sin(5.3 * t)
    columns = np.stack([speed, np.cos(3.3 * t), np.sign(speed), np.sin(7.0 * t)], -1)
    chol = np.linalg.cholesky(np.exp(-np.abs(np.subtract.outer(t[0], t[0])) / tau) + 1e-9 * np.eye(ROWS))
    force = force_std * rng.normal(size=(windows, ROWS)) @ chol.T + effect * np.sign(speed)
    residual = force @ impulse.T + noise * rng.normal(size=(windows, ROWS + 1))
    response = impulse @ columns
    return Linearised(
        residual=residual,
        jac_state=np.broadcast_to(jac_state, (windows, ROWS + 1, 2)),
        jac_theta=response[..., :2],
        atoms=response[..., 2:],
        impulse=np.broadcast_to(impulse[:, None], (windows, ROWS + 1, 1, ROWS)),
        dt=np.full((windows, ROWS), DT),
        channel=np.zeros(ROWS + 1, int),
        trial=np.arange(windows) * trials // windows,
        used=np.ones((windows, ROWS + 1), bool),
    )
