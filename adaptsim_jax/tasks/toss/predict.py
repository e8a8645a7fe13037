"""Stretches of tosses simulated from starts that are fitted to their first rows alone: whole tosses
from their flight.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from adaptsim_jax.tasks.toss.catalogue import quantities
from adaptsim_jax.tasks.toss.problem import anchored, seen_less
from adaptsim_jax.tasks.toss.read import Tossed
from adaptsim_jax.tasks.toss.simulate import poses
from adaptsim_jax.tasks.toss.windows import CLEAR, LEAST, flight, gathered

Span = tuple[int, int, int]


def values_of(tossed: Tossed, given: Mapping[str, float]) -> np.ndarray:
    """Values `[P]` of all quantities: `given`, the others as declared."""
    return np.array([given.get(q.name, q.neutral) for q in quantities(tossed.body)])


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
        return seen_less(tossed, first, names, at, v, start)

    anchor, _ = anchored(less, np.arange(len(spans)), values, first.start)
    place, _ = poses(tossed.body, names, values, anchor.start, whole.time)
    return [(m - p)[k > 0] for m, p, k in zip(whole.place, place, whole.mask, strict=True)]


def flights(tossed: Tossed) -> tuple[list[Span], list[int]]:
    """Whole tosses that begin with a flight, and its rows."""
    corners, spans, rows = tossed.body.corners(), [], []
    for t, (place, turn) in enumerate(zip(tossed.place, tossed.turn, strict=True)):
        count = flight(place, turn, corners, CLEAR * tossed.body.size)
        if LEAST <= count < len(place):
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
