"""Which rows of a log make stretches that are simulated: about so many as are wanted."""

from collections.abc import Sequence

import numpy as np

Row = tuple[int, ...]
"""A trial and rows of a stretch there."""


def spread(parts: Sequence[Sequence[Row]], most: int) -> list[Row]:
    """About `most` stretches of all parts, evenly spread, and where there is room at least one of
    each part: a trial that is left out tells nothing.
    """
    if len(parts) > most:
        parts = [[row for part in parts for row in part]]
    total = sum(map(len, parts))
    chosen = []
    for part in parts:
        count = max(1, round(min(1.0, most / total) * len(part)))
        places = np.linspace(0, len(part) - 1, count).round().astype(int)
        chosen += [part[i] for i in np.unique(places)]
    return chosen
