"""The exact motion of a linear system under a gain, by SciPy's matrix exponential."""

import numpy as np
from scipy.linalg import expm


def linear_trajectory(A, B, gain, x0, times) -> tuple[np.ndarray, np.ndarray]:
    """States [T, n] and commands [T, m] under u = -gain x at equispaced times [T] s from 0."""
    A, B, gain, x0 = (np.asarray(z, float) for z in (A, B, gain, x0))
    power, states = expm((A - B @ gain) * float(times[1] - times[0])), [x0]
    for _ in times[1:]:
        states.append(power @ states[-1])
    return np.array(states), -np.array(states) @ gain.T
