"""When the plate reaches the bottle and how fast that then goes, by the commands alone: what a
clock of another rate contradicts.
"""

from collections.abc import Sequence

import numpy as np

from adaptsim_jax.tasks.pushing import model
from adaptsim_jax.tasks.pushing.slide import edge_halfway
from adaptsim_jax.tasks.trial_clock import MOVED, NEVER, Touch, check_clock_rate

USUAL = 1.37
"""Greatest speed of a bottle over the plate's at the hit: 1.2 to 1.5 over Omega."""
LATER = 1.06
"""Times later than by a stiff bottle and an even speed."""
STEP = 0.001  # s


def touch(actions: np.ndarray, starts: np.ndarray) -> Touch:
    """Of pushes with `actions [T, 2]` m/s, rad and bottles at `starts [T, 2]` m: reached where the
    bottle has moved by `MOVED`.
    """
    edge = np.asarray(edge_halfway(model.PUSH_ENDS, STEP), float)
    time = (np.arange(len(edge)) + 0.5) * STEP
    along = np.stack([np.cos(actions[:, 1]), np.sin(actions[:, 1])], 1)
    ahead = np.sum((starts - np.array(model.START)) * along, 1)
    gap = ahead + model.LINK_BACK - model.EDGE_RADIUS - model.RADIUS

    def hit(f: float) -> tuple[np.ndarray, np.ndarray]:
        speed = f * actions[:, :1]
        past = speed * edge[:, 0] + edge[:, 1] > gap[:, None]
        first = np.argmax(past, axis=1)
        plate = speed[:, 0] * edge[first, 2] + edge[first, 3]
        late = LATER * (time[first] + MOVED / np.maximum(USUAL * plate, 0.05))
        return np.where(past.any(1), late, NEVER), USUAL * np.maximum(plate, 1e-3)

    return Touch(lambda f: hit(f)[0], lambda f: hit(f)[1])


def check_hits(
    seen: Sequence[tuple[float, float]],
    actions: np.ndarray,
    starts: np.ndarray,
    where: str,
    body: str = "the bottle",
) -> None:
    """BadInput where pushes contradict the rate of their clock; see `trial_clock`."""
    check_clock_rate(
        seen, touch(np.asarray(actions, float), np.asarray(starts, float)), where, body
    )
