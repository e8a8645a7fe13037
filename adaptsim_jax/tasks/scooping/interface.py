"""What all engines of scooping share: rows and states of a trajectory, checked batches, places and
outcomes.

`state [B, T, 6]` holds, in rows of `ROW` s, the piece's x, y, z m and the tip's x, z m and pitch
rad.
"""

from typing import Any

import numpy as np

from adaptsim_jax.tasks.engine import Trajectory, checked_batch
from adaptsim_jax.tasks.scooping import model

ROW = 0.01  # s between rows; row k is at (k + 1) ROW
STATE = 6
BATCH = 64  # trials side by side on a CPU: more do not fit into its cache


def checked(params: Any, commands: Any, initial: Any) -> list[np.ndarray]:
    """The batch as arrays `[B, 4]`, `[B, 3]`, `[B, 2]`; BadInput where shapes do not fit
    together.
    """
    given = {"params": params, "commands": commands, "initial": initial}
    return checked_batch("scooping", given, (4, 3, 2))


def placed(state: np.ndarray, codes: np.ndarray, starts: np.ndarray) -> Trajectory:
    """The trajectory with lengths along the table counted as the caller does."""
    state[..., 0] += starts[:, None, 0]
    state[..., 1] += starts[:, None, 1]
    state[..., 3] += starts[:, None, 0]
    return Trajectory(state, codes)


def outcome(state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`(success [B], above [B] m)` at the end of `state [B, T, 6]`; `above`: height over the tip's
    plane.
    """
    x, _, z, tip_x, tip_z, pitch = np.moveaxis(state[:, -1], -1, 0)
    c, s = np.cos(pitch), np.sin(pitch)
    ahead, above = c * (x - tip_x) - s * (z - tip_z), s * (x - tip_x) + c * (z - tip_z)
    return np.asarray(model.on_blade(ahead, above)), above
