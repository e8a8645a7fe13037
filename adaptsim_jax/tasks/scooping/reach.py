"""When the blade reaches the piece and how fast that then goes, by the commands alone: what a clock
of another rate contradicts.
"""

from collections.abc import Sequence

import jax
import numpy as np

from adaptsim_jax.tasks.scooping import model
from adaptsim_jax.tasks.scooping.model import ScoopOptions
from adaptsim_jax.tasks.scooping.motion import motion
from adaptsim_jax.tasks.trial_clock import MOVED, NEVER, Touch, check_clock_rate

USUAL, LATER = 1.0, 1.1
"""Greatest speed of a piece over the blade's, and times later than by a box that is pushed at once:
1.0 to 1.25 over Omega.
"""
STEPS = 1000


def touch(actions: np.ndarray, options: ScoopOptions = ScoopOptions()) -> Touch:  # noqa: B008
    """Of scoops with `actions [T, 3]` rad, rad/s, m: reached where the tip has pushed the piece by
    `MOVED`.
    """
    poses = jax.vmap(lambda a: motion(a, STEPS, options)[:, 0])(np.asarray(actions, np.float32))
    tip, time = np.asarray(poses, float), np.linspace(0.0, model.SECONDS, STEPS + 1)
    fastest = np.max(np.diff(tip, axis=1), axis=1) * STEPS / model.SECONDS

    def reached(f: float) -> np.ndarray:
        # the blade starts `RADIUS + distance` before the piece's middle, and meets its rim
        past = tip[:, :1] + f * (tip - tip[:, :1]) > MOVED - model.RADIUS
        return np.where(past.any(1), LATER * time[np.argmax(past, axis=1)], NEVER)

    return Touch(reached, lambda f: f * USUAL * fastest)


def check_reach(
    seen: Sequence[tuple[float, float]], actions: np.ndarray, options: ScoopOptions, where: str
) -> None:
    """BadInput where scoops contradict the rate of their clock; see `trial_clock`."""
    check_clock_rate(seen, touch(actions, options), where, "the piece")
