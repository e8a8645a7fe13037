"""A clock of another rate than the arm's, and an arm of another speed than commanded: told by when
bodies begin to move, and how fast.

What an arm was commanded says when it reaches a body and how fast it is then, whatever is adapted
of a task. A slow clock makes both late and slow by the same factor; an arm that runs slowly is less
late than slow, since it reaches the body while it gathers speed.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from adaptsim_jax.core.errors import BadInput

MOVED = 0.01
"""m from its first place at which a body counts as moving."""
WINDOW = 0.17
"""Share of the time until then over which its greatest speed is taken: of any clock the same part
of the motion.
"""
NEVER = 100.0
"""s that stand for an arm that never reaches its body."""
SLOW = 1.4
"""Times by which a clock must be slow or fast to be refused: what is less is an effect that is
named.
"""
AGREE = 1.5
"""Times that the two may say otherwise: a soft body leaves slowly, a hard one fast."""
ARMS = np.geomspace(0.1, 10.0, 41)
"""Times the commanded speed at which an arm may run instead."""
ON_TIME = 0.1
"""Natural logarithm by which a beginning is sure, and `AGREE`'s for a speed."""


@dataclass(frozen=True)
class Touch:
    """What commands say if arms run `f` times as fast as commanded, `[T]`: `reached(f)` s at which
    bodies have moved by `MOVED`, and `speed(f)` m/s that they then have, as usual.
    """

    reached: Callable[[float], np.ndarray]
    speed: Callable[[float], np.ndarray]


def began(time: np.ndarray, places: np.ndarray) -> tuple[float, float]:
    """When a body with `places [R, 2]` m at `time [R]` s has moved by `MOVED`, s, and its greatest
    speed from then on, m/s; NaN where it never does, or moves as it is first seen.
    """
    far = np.linalg.norm(places - places[0], axis=1)
    k = int(np.argmax(far > MOVED))
    if k < 1 or len(time) < 8 or far[2] > MOVED / 2:
        return float("nan"), float("nan")
    at = float(np.interp(MOVED, [far[k - 1], far[k]], [time[k - 1], time[k]]))
    # a few rows at least, so that noise is no speed
    step = max(3, round(WINDOW * at / float(np.median(np.diff(time)))))
    a, b = np.arange(max(k - 1, 0), len(time) - step), np.arange(max(k - 1, 0) + step, len(time))
    if not len(a):
        return at, float("nan")
    return at, float(np.max(np.linalg.norm(places[b] - places[a], axis=1) / (time[b] - time[a])))


def clock_rate(seen: Sequence[tuple[float, float]], touch: Touch) -> float | None:
    """How many times too slow the clock is (below 1: too fast) by what `began` says of each trial
    `[T]`; None where it need not be.
    """
    at, speed = np.asarray(seen, float).T
    known = np.isfinite(at) & np.isfinite(speed) & (at > 0) & (speed > 0)
    if 2 * known.sum() < len(known) or not known.any():
        return None

    def off(f: float) -> tuple[float, float]:
        late, slow = np.log(at / touch.reached(f)), np.log(touch.speed(f) / speed)
        return float(np.median(late[known])), float(np.median(slow[known]))

    by_time, by_speed = off(1.0)
    least, most = sorted((by_time, by_speed))
    if not (least > np.log(SLOW) or most < -np.log(SLOW)) or most - least > np.log(AGREE):
        return None

    def cost(late, slow):
        return (late / ON_TIME) ** 2 + (slow / np.log(AGREE)) ** 2

    clock = min(cost(by_time - r, by_speed - r) for r in np.linspace(least, most, 9))
    arm = min(cost(*off(float(f))) for f in ARMS)
    if clock < arm:
        return float(np.exp(by_time))
    return None


def check_clock_rate(
    seen: Sequence[tuple[float, float]], touch: Touch, where: str, body: str
) -> None:
    """BadInput, naming `where`, where the clock of the trials runs several times too slow or too
    fast.
    """
    rate = clock_rate(seen, touch)
    if rate is None:
        return
    at, speed = np.nanmedian(np.asarray(seen, float), axis=0)
    due, usual = float(np.median(touch.reached(1.0))), float(np.median(touch.speed(1.0)))
    if rate > 1:
        times, slow, mend = (rate, "slow", "divide")
    else:
        times, slow, mend = (1 / rate, "fast", "multiply")
    raise BadInput(
        f"{where}: {body} begins to move at {at:.2g} s and goes {speed:.2g} m/s, where the arm as "
        f"commanded reaches it at {due:.2g} s "
        f"and gives it {usual:.2g} m/s: time looks about {times:.2g} times too {slow} (frames "
        f"counted at another rate than the "
        f"camera's?); {mend} column time by {times:.2g}; if all is as declared, add --as-declared"
    )
