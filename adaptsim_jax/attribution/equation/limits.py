"""What the limits of an actuator leave of the force that follows a command held from row to row."""

from collections.abc import Sequence

import numpy as np
import scipy.ndimage

from adaptsim_jax.attribution.criteria import WINDOW

HALVINGS = 30  # times that an interval is halved, in which a mean force is sought: 1e-9 of it


def limited(
    force: np.ndarray,
    spike: np.ndarray,
    ends: np.ndarray,
    slow: np.ndarray,
    row: np.ndarray,
    clock: np.ndarray,
    runs: Sequence[slice],
) -> np.ndarray:
    """Mean force [n, T] of actuators with limits, where without them it is `force`. What is cut off
    spikes is read off what is smooth, since it bends: the noise of a speed times a controller's
    damping would be taken for force.

    Args:
        force, spike: [n, T] N m, N.
        ends: lower and upper limit, [2, n, 1].
        slow, row: as of `left_of`.
        clock: [T] s.
        runs: the rows of each trial.
    """
    rows = max(1, round(WINDOW.smooth * WINDOW.span / float(clock[1] - clock[0])))
    wide = 2.0 * np.abs(spike)
    part = np.clip(force, ends[0] - wide, ends[1] + wide)
    smooth = np.concatenate(
        [scipy.ndimage.uniform_filter1d(part[:, r], rows, axis=1, mode="nearest") for r in runs], 1
    )
    way = np.where(spike < 0.0, -1.0, 1.0)
    limit = np.where(way > 0.0, ends[1], -ends[0])
    left = left_of(way * smooth, np.abs(spike), limit, slow, row)
    cut = np.isfinite(limit) & (np.abs(force - smooth) < np.abs(spike))
    return np.clip(force, *ends) + np.where(cut, way * left - np.clip(smooth, *ends), 0.0)


def left_of(
    asked: np.ndarray, spike: np.ndarray, limit: np.ndarray, slow: np.ndarray, row: np.ndarray
) -> np.ndarray:
    """Mean force that a limit leaves of one `asked` for, with spikes. A command that is held jumps
    from row to row by so much as the joint moves, and the force with it (`spike`). Within about
    `slow` s (inertia over damping) the joint has the speed that this asks for, and the force is
    down again. Where limits cut a spike that takes longer: with m the mean, the force begins a = m
    + peak - limit above the limit and falls by (limit - m) / slow + spike / row a second. m is
    found by bisection.

    Args:
        asked, spike, limit: [n, T] N m, N; spike at least 0, `limit` the one on its side.
        slow, row: s.

    Returns:
        [n, T].
    """
    rows = np.maximum(row / slow, 1e-3)
    peak = spike * (1.0 / -np.expm1(-rows) - 1.0 / rows)
    low, high = np.minimum(asked, -limit) - spike, np.minimum(asked, limit)
    for _ in range(HALVINGS):
        m = 0.5 * (low + high)
        falls = (limit - m) / slow + spike / row
        over = (
            m + 0.5 * np.square(np.maximum(m + peak - limit, 0.0)) / np.maximum(falls * row, 1e-300)
            > asked
        )
        low, high = np.where(over, low, m), np.where(over, m, high)
    return 0.5 * (low + high)
