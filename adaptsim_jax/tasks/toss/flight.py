"""What flights say: of the recording's clock, its lengths and gravity; and of whole tosses, which are
simulated from starts that are fitted to their first rows alone.
"""  # noqa: E501

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from adaptsim_jax.tasks.toss.catalogue import quantities
from adaptsim_jax.tasks.toss.problem import anchored, scaled_residual
from adaptsim_jax.tasks.toss.read import Tossed
from adaptsim_jax.tasks.toss.simulate import poses
from adaptsim_jax.tasks.toss.windows import CLEAR, MIN_ROWS, flight, gathered

DRAWS = 2000


@dataclass(frozen=True)
class Flight:
    """gravity: At which bodies fall as recorded in m/s^2, `low` to `high` (95 %, over tosses); each
    `[F]` of a toss. aside: Median acceleration in x and y. declared: Of the model.
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

    The point that is recorded is taken for the centre of mass. The median over tosses bears some
    that were touched or spin about another point.
    """
    corners, found = tossed.body.corners(), []
    for time, place, turn in zip(tossed.time, tossed.place, tossed.turn, strict=True):
        rows = flight(place, turn, corners, CLEAR * tossed.body.size)
        if rows >= MIN_ROWS:
            found.append(2.0 * np.polyfit(time[:rows], place[:rows], 2)[0])
    if not found:
        return None
    a = np.array(found)
    draws = np.random.default_rng(0).integers(0, len(a), (DRAWS, len(a)))
    low, high = np.quantile(np.median(-a[draws, 2], axis=1), [0.025, 0.975])
    each, aside = -a[:, 2], np.median(a[:, :2], 0)
    gravity = float(np.median(each))
    return Flight(gravity, float(low), float(high), each, aside, tossed.body.gravity)


def words(found: Flight) -> str:
    """One sentence."""
    falls = f"free flight falls at {found.gravity:.2f} m/s2 ({found.low:.2f} to {found.high:.2f})"
    if not found.off:
        return f"{falls}, as declared ({found.declared:.2f})."
    long = "long" if found.scale > 0 else "short"
    fast = "fast" if found.clock > 0 else "slow"
    return (
        f"{falls} where {found.declared:.2f} is declared: lengths {100 * abs(found.scale):.1f} % "
        f"too {long}, a clock {100 * abs(found.clock):.1f} % {fast}, or another gravity; flight "
        "alone does not tell which."
    )


Span = tuple[int, int, int]


def values_of(tossed: Tossed, given: Mapping[str, float]) -> np.ndarray:
    """Values `[P]` of all quantities: `given`, the others as declared."""
    return np.array([given.get(q.name, q.default) for q in quantities(tossed.body)])


def predicted(
    tossed: Tossed, values: np.ndarray, spans: Sequence[Span], rows: Sequence[int]
) -> list[np.ndarray]:
    """Off by what `[R, 3]` m, measured less simulated, in each span (toss, first row, row after the
    last), its start fitted to so many `rows`; values `[S, P]`, of each span its own.
    """
    names = tuple(q.name for q in quantities(tossed.body))
    first = gathered(tossed, [(t, a, a + n) for (t, a, _), n in zip(spans, rows, strict=True)])
    whole = gathered(tossed, list(spans))

    def less(at, v, start):
        return scaled_residual(tossed, first, names, at, v, start)

    anchor, _ = anchored(less, np.arange(len(spans)), values, first.start)
    place, _ = poses(tossed.body, names, values, anchor.start, whole.time)
    return [(m - p)[k > 0] for m, p, k in zip(whole.place, place, whole.mask, strict=True)]


def flights(tossed: Tossed) -> tuple[list[Span], list[int]]:
    """Whole tosses that begin with a flight, and its rows."""
    corners, spans, rows = tossed.body.corners(), [], []
    for t, (place, turn) in enumerate(zip(tossed.place, tossed.turn, strict=True)):
        count = flight(place, turn, corners, CLEAR * tossed.body.size)
        if MIN_ROWS <= count < len(place):
            spans.append((t, 0, len(place)))
            rows.append(count)
    return spans, rows


def whole_tosses(tossed: Tossed, vectors: np.ndarray) -> np.ndarray:
    """RMS `[F]` m of the place's distance over each whole toss from its flight; vectors `[T, P]`:
    values for each toss.
    """
    spans, rows = flights(tossed)
    if not spans:
        return np.zeros(0)
    off = predicted(tossed, vectors[[t for t, _, _ in spans]], spans, rows)
    return np.array([np.sqrt(np.square(z).sum(1).mean()) for z in off])
