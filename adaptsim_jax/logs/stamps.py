"""When messages are from: their own stamps, where these are of one clock, and times of arrival
where they have none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

WINDOW = 10
"""Messages on each side by which a stamp is judged."""
FAR = 10**9
"""ns by which a stamp's distance from its arrival may differ from those of its neighbours."""


@dataclass(frozen=True)
class Stamped:
    """`time [K]` ns of messages, `kept [K]`: those that have one; `stamped`: whether times are
    their own; `late`: how long they are on their way (median, ns); `unstamped`, `far`: how many
    lack a stamp, or have one far from the others'.
    """

    time: np.ndarray
    kept: np.ndarray
    stamped: bool
    late: int
    unstamped: int = 0
    far: int = 0

    def notes(self, topic: str) -> tuple[str, ...]:
        """What a person should know of it."""
        if not self.stamped:
            return (f"topic {topic} has no stamps: the bag's time of arrival is taken",)
        left = "left out, the others keep theirs"
        if self.unstamped:
            out = [f"topic {topic}: {self.unstamped} messages without a stamp {left}"]
        else:
            out = []
        return (
            *out,
            *(
                [f"topic {topic}: {self.far} stamps far from the others' {left}"]
                if self.far
                else []
            ),
        )


def stamped(arrived: np.ndarray, stamps: np.ndarray, group: np.ndarray | None = None) -> Stamped:
    """Times of messages that arrived at `arrived [K]` ns with stamps `[K]` (0: none). group [K]:
    who sends; a sender of whom no message has a stamp counts by arrival, less the delay of the
    others.
    """
    has = stamps > 0
    far = has & _far(arrived, stamps, has)
    good = has & ~far
    if (
        not good.any()
        or good.sum() <= len(stamps) / 2
        or len(set(stamps[good].tolist())) <= good.sum() / 2
    ):
        return Stamped(arrived, np.ones(len(arrived), bool), False, 0)
    late = int(np.median((arrived - stamps)[good]))
    time = np.where(good, stamps, arrived - late)
    kept = good.copy()
    for one in set(group.tolist()) if group is not None else ():
        here = group == one
        if not good[here].any():
            kept |= here
    return Stamped(time, kept, True, late, int(np.sum(~has & ~kept)), int(np.sum(far & ~kept)))


def _far(arrived: np.ndarray, stamps: np.ndarray, has: np.ndarray) -> np.ndarray:
    """Which stamps are far off: those whose distance from their arrival is not that of the stamps
    around them. A simulated clock may run at another pace, so that the neighbours alone judge, by
    so much more as they are apart.
    """
    at = np.flatnonzero(has)
    out = np.zeros(len(stamps), bool)
    if len(at) < 5:
        return out
    off, when = (arrived - stamps)[at], arrived[at]
    width = min(2 * WINDOW + 1, len(at))
    first = np.clip(np.arange(len(at)) - width // 2, 0, len(at) - width)
    around = first[:, None] + np.arange(width)
    apart = np.abs(when - np.median(when[around], axis=1))
    out[at] = np.abs(off - np.median(off[around], axis=1)) > FAR + apart
    return out
