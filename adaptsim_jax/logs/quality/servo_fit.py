"""How well a command explains a joint's motion, without a model of the mechanism: acceleration
against command, angle and speed.

A joint under a servo or a motor accelerates by what it is told, by where it is and how fast it
moves, and by gravity; each acts about linearly (`a = k u - p q - d v + g sin q + h cos q + c`). Of
two readings of the command the one that leaves less is the one that acted. NumPy alone.
"""

from collections.abc import Sequence

import numpy as np

from adaptsim_jax.logs.quality.hypotheses import Track, blocks

SMOOTH = 3
"""Blocks over which both sides of the equation are averaged, so that noise of the angles counts
less.
"""
ALIKE = 6.0
"""Rows that what is left stays alike over."""
LEAST = 30
"""Blocks below which nothing is said."""


def unexplained(tracks: Sequence[Track]) -> float:
    """Share of the square of the acceleration that a command leaves; each track of one joint (`q
    [T, 1]`), `tau [T, 1]` the command. NaN where the motion is too short, or where nothing moves or
    is commanded.
    """
    rows = [_rows(track) for track in tracks]
    a = np.concatenate([r[0] for r in rows])
    columns = np.concatenate([r[1] for r in rows])
    if len(a) < LEAST or np.std(a) < 1e-9 or np.std(columns[:, 0]) < 1e-12:
        return float("nan")
    size = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-12)
    x, *_ = np.linalg.lstsq(columns / size, a, rcond=1e-9)
    left = a - columns / size @ x
    return float(np.sum(left**2) / np.sum((a - a.mean()) ** 2))


def gain(tracks: Sequence[Track]) -> tuple[float, float, float] | None:
    """Acceleration by unit of a joint's command, its standard error, and the share of the
    acceleration that is left; None where the motion is too short. Rows beside one another are not
    independent, which the error allows for.
    """
    rows = [_rows(track) for track in tracks]
    a, columns = (np.concatenate([r[k] for r in rows]) for k in (0, 1))
    if len(a) < LEAST or np.std(a) < 1e-9 or np.std(columns[:, 0]) < 1e-12:
        return None
    size = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-12)
    whole = columns / size
    gram = whole.T @ whole + 1e-9 * len(a) * np.eye(whole.shape[1])
    x = np.linalg.solve(gram, whole.T @ a)
    left = a - whole @ x
    spread = float(np.sum(left**2)) / max(len(a) / ALIKE - whole.shape[1], 1.0) / ALIKE
    error = np.sqrt(spread * ALIKE * np.linalg.inv(gram)[0, 0])
    return (
        float(x[0] / size[0]),
        float(error / size[0]),
        float(np.sum(left**2) / np.sum((a - a.mean()) ** 2)),
    )


def _rows(track: Track) -> tuple[np.ndarray, np.ndarray]:
    """Accelerations `[K]` and columns `[K, 6]` of one trial."""
    here = np.isfinite(track.q[:, 0]) & np.isfinite(track.tau[:, 0])
    if here.sum() < 12:
        return np.zeros(0), np.zeros((0, 6))
    whole = Track(
        track.time[here], track.q[here], None if track.v is None else track.v[here], track.tau[here]
    )
    q, v, a, u, _ = blocks(whole, sharp=True)
    q, v, a, u = (x[:, 0] for x in (q, v, a, u))
    table = np.stack([u, q, v, np.sin(q), np.cos(q), np.ones_like(q), a], 1)
    if len(table) < 2 * SMOOTH:
        return np.zeros(0), np.zeros((0, 6))
    mean = np.stack([np.convolve(c, np.ones(SMOOTH) / SMOOTH, "valid") for c in table.T], 1)
    return mean[:, -1], mean[:, :-1]
