"""What the free flight by itself says of the recording's clock, its lengths, and gravity."""

from dataclasses import dataclass

import numpy as np

from adaptsim_jax.tasks.toss.read import Tossed
from adaptsim_jax.tasks.toss.windows import CLEAR, LEAST, flight

DRAWS = 2000


@dataclass(frozen=True)
class Flight:
    """gravity: at which bodies fall as recorded in m/s^2, `low` to `high` (95 %, over tosses); each
    `[F]` of a toss; aside: median acceleration in x and y; declared: of the model.
    """

    gravity: float
    low: float
    high: float
    each: np.ndarray
    aside: np.ndarray
    declared: float

    @property
    def off(self) -> bool:
        """Whether the declared gravity lies outside of the interval."""
        return not self.low <= self.declared <= self.high

    @property
    def scale(self) -> float:
        """Share by which lengths would be too long."""
        return self.gravity / self.declared - 1.0

    @property
    def clock(self) -> float:
        """Share by which the recording's clock would run fast (negative: slow)."""
        return 1.0 / np.sqrt(self.gravity / self.declared) - 1.0


def free_flight(tossed: Tossed) -> Flight | None:
    """Parabolas through each toss before it first comes near the plane; None where no toss flies
    long enough.

    The point that is recorded is taken for the centre of mass; the median over tosses bears some
    that were touched or spin about another point.
    """
    corners, found = tossed.body.corners(), []
    for time, place, turn in zip(tossed.time, tossed.place, tossed.turn, strict=True):
        rows = flight(place, turn, corners, CLEAR * tossed.body.size)
        if rows >= LEAST:
            found.append(2.0 * np.polyfit(time[:rows], place[:rows], 2)[0])
    if not found:
        return None
    a = np.array(found)
    draws = np.random.default_rng(0).integers(0, len(a), (DRAWS, len(a)))
    low, high = np.quantile(np.median(-a[draws, 2], axis=1), [0.025, 0.975])
    return Flight(
        float(np.median(-a[:, 2])),
        float(low),
        float(high),
        -a[:, 2],
        np.median(a[:, :2], 0),
        tossed.body.gravity,
    )


def words(found: Flight) -> str:
    """One sentence."""
    falls = f"free flight falls at {found.gravity:.2f} m/s2 ({found.low:.2f} to {found.high:.2f})"
    if not found.off:
        return f"{falls}, as declared ({found.declared:.2f})."
    long = "long" if found.scale > 0 else "short"
    fast = "fast" if found.clock > 0 else "slow"
    return (
        f"{falls} where {found.declared:.2f} is declared: lengths {100 * abs(found.scale):.1f} % "
        f"too {long}, a clock "
        f"{100 * abs(found.clock):.1f} % {fast}, or another gravity; flight alone does not tell "
        f"which."
    )
